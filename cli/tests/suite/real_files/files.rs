//! Names of files, encodings, images, and errors that list all that is missing.
