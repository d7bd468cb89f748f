//! Act three: looking at a scene whose light is known.
//!
//! In: a [`Scene`](crate::scene::Scene), a camera, and a function that gives the radiance of a hit. Out: a
//! [`Picture`](image::Picture) in linear radiance, tone-mapped bitmaps, files, and measures of how
//! far two pictures are apart. Section 6 of the paper.

pub mod mapping;

pub mod packed;

pub mod cache;

pub mod maps;

pub mod recent;

pub mod packet;

pub mod accessor;

pub mod lightfield;

mod ahead;

pub mod image;

pub mod tone;

pub mod compare;

pub mod path;

pub mod render;
