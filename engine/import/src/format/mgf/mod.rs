//! Reader of MGFE: MGF 1.1 (Materials and Geometry Format \[ward1995\]) with cameras, media, textures and animation.
//!
//! The reader makes one pass. Each line changes the contexts or adds to the scene with the current contexts. Where MGF's
//! specification is ambiguous, this reader follows the reference parser: a mirrored face is reversed, so that a mirror image keeps
//! its front sides, and `-a` takes its arguments up to the next `-a` or `-i`. Cameras are always in world coordinates; `mbox`
//! follows the enclosing transforms.

mod animation;
mod args;
mod camera;
mod color;
mod include;
mod lexer;
mod luminaire;
mod material;
mod medium;
mod object;
mod polygon;
mod reader;
mod recovery;
mod spectrum;
mod stack;
mod surface;
mod table;
mod texture;
mod transform;
mod vertex;

pub(crate) use reader::load;
