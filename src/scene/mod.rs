//! What is lit: surfaces, materials, emitters, texels and the camera, resolved and checked.
//!
//! In: a Wavefront OBJ with its MTL, or glTF ([`Scene::open`]). Out: a [`Scene`] in which every vertex is
//! finite and inside the unit ball, every polygon planar and of positive area, every reflectance in
//! [0, 1], every surface one plane and one material. Nothing downstream checks again.

use crate::ids::{MaterialId, SurfaceId};
use crate::radiance::Rgb;
use glam::{DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

pub use error::SceneError;
pub use image::Image;
pub use report::{Counts, NamedCamera, Note, NoteKind, Report};
pub use texture::{Placement, Texture};

mod error;

mod report;

mod scan;

mod scan_mtl;

pub mod image;

pub mod texture;

mod material;

mod outline;

pub mod triangulate;

mod flat;

mod overlap;

mod dissolve;

mod merge;

mod assemble;

mod read;

mod gltf;

#[cfg(test)]
mod tests;

#[cfg(test)]
pub(crate) mod test_scenes;

pub mod camera;

pub mod bundled;

pub mod boxes;

pub mod cuts;

pub mod texels;

pub mod areas;

pub mod reflectances;

pub mod contacts;

pub mod stored;

/// A resolved scene, fitted to the unit ball about the origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The surfaces; a [`SurfaceId`] is an index into them.
    pub surfaces: Vec<Surface>,
    /// The materials; a [`MaterialId`] is an index into them.
    pub materials: Vec<Material>,
    /// The images of textured materials, each once.
    pub images: Vec<Image>,
    /// From the scene's own units to the unit ball.
    pub fit: Fit,
}

/// How the scene's own units are fitted to the unit ball: `unit = (own - centre) / radius`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Centre of the bounding sphere, in the scene's own units.
    pub centre: DVec3,
    /// Radius of the bounding sphere, in the scene's own units; positive.
    pub radius: f64,
}

/// A planar piece of the scene: one polygon, or coplanar adjacent polygons of one material.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// What it is made of.
    pub material: MaterialId,
    /// Unit normal of the front side, from which the polygons run counter-clockwise.
    pub normal: Vec3,
    /// A corner of the rectangle that bounds the polygons in their plane.
    pub origin: Vec3,
    /// Unit vector along the rectangle's first edge.
    pub u: Vec3,
    /// Unit vector along the rectangle's second edge; `u x v = normal`.
    pub v: Vec3,
    /// Lengths of the rectangle's edges along `u` and `v`, in the fitted scene's units.
    pub extent: Vec2,
    /// Its texels are `2^fineness` times as many along each edge as elsewhere; 0 as it is read.
    pub fineness: u8,
    /// The polygons: simple loops, not necessarily convex, that do not overlap each other.
    pub polygons: Vec<Polygon>,
    /// Where the image of its material lies on it; `None` without one, and where no texture
    /// coordinates say it: the image's mean stands for it there.
    pub placement: Option<Box<Placement>>,
}

/// A simple planar polygon: at least three vertices, counter-clockwise about its surface's normal.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// The corners, in the fitted scene's units.
    pub vertices: Vec<Vec3>,
}

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the scene's file.
    pub name: String,
    /// Radiance emitted from the front side, W sr^-1 m^-2.
    pub emitted: Rgb,
    /// What becomes of light that arrives; of a textured material, in the mean over its image.
    pub reflectance: Reflectance,
    /// The image that a diffuse material has.
    pub texture: Option<Texture>,
}

/// How a material reflects; the factors lie in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reflectance {
    /// Ideal diffuse.
    Diffuse(Rgb),
    /// Ideal mirror, the same factor at every angle.
    Mirror(Rgb),
}

impl Reflectance {
    /// The factor, whichever kind it is.
    pub fn factor(self) -> Rgb {
        match self {
            Reflectance::Diffuse(rho) | Reflectance::Mirror(rho) => rho,
        }
    }

    /// Whether it is a mirror.
    pub fn is_mirror(self) -> bool {
        matches!(self, Reflectance::Mirror(_))
    }
}

impl Scene {
    /// The surface with an id.
    pub fn surface(&self, id: SurfaceId) -> &Surface {
        &self.surfaces[id.index()]
    }

    /// The material of a surface.
    pub fn material_of(&self, id: SurfaceId) -> &Material {
        &self.materials[self.surface(id).material.index()]
    }

    /// All surface ids in order.
    pub fn surface_ids(&self) -> impl Iterator<Item = SurfaceId> + use<> {
        (0..self.surfaces.len() as u32).map(SurfaceId)
    }

    /// Number of polygons over all surfaces.
    pub fn polygon_count(&self) -> usize {
        self.surfaces.iter().map(|s| s.polygons.len()).sum()
    }
}

impl Fit {
    /// A point of the scene's own units in the unit ball.
    pub fn to_unit(&self, own: DVec3) -> Vec3 {
        ((own - self.centre) / self.radius).as_vec3()
    }

    /// A point of the unit ball in the scene's own units.
    pub fn to_own(&self, unit: Vec3) -> DVec3 {
        unit.as_dvec3() * self.radius + self.centre
    }
}

impl Polygon {
    /// Area in the fitted scene's units, positive for loops counter-clockwise about `normal`.
    pub fn area(&self, normal: Vec3) -> f32 {
        let v = &self.vertices;
        let n = normal.as_dvec3();
        let o = v[0].as_dvec3();
        let twice: f64 = (1..v.len() - 1)
            .map(|i| (v[i].as_dvec3() - o).cross(v[i + 1].as_dvec3() - o).dot(n))
            .sum();
        (0.5 * twice) as f32
    }
}

impl Surface {
    /// Area of one side, in the fitted scene's units.
    pub fn area(&self) -> f32 {
        self.polygons.iter().map(|p| p.area(self.normal)).sum()
    }

    /// Coordinates of a point of the plane along `u` and `v` from `origin`, in the fitted scene's units.
    pub fn coordinates(&self, point: Vec3) -> Vec2 {
        let d = point - self.origin;
        Vec2::new(d.dot(self.u), d.dot(self.v))
    }
}
