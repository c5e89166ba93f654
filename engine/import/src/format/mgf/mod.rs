//! MGFE: MGF 1.1 (Materials and Geometry Format \[ward1995\]) with cameras, media, textures and animation.
//!
//! One pass: each line changes the reader's contexts or adds to the scene, with the contexts as they stand at that line.
//! Where MGF's text leaves a choice, the reference parser's readers decide: a mirrored face is reversed, so that a mirror
//! image keeps its front sides; `-a` takes its arguments up to the next `-a` or `-i`. Cameras are in world coordinates
//! wherever they are opened; `mbox` follows the transforms around it.

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
