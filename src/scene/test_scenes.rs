//! Scenes for the tests under this module, built by hand.

use crate::ids::MaterialId;
use crate::radiance::Rgb;
use crate::scene::{Fit, Material, Polygon, Reflectance, Scene, Surface};
use glam::{DVec3, Vec2, Vec3};

/// A small generator of numbers in [-1, 1) (SplitMix64).
pub struct Dice(pub u64);

impl Dice {
    /// The next number.
    pub fn roll(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    /// A point in the unit ball.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.roll(), self.roll(), self.roll()) * 0.57
    }
}

/// A grey material; `emitted` in W sr^-1 m^-2.
pub fn material(name: &str, emitted: f32, reflectance: Reflectance) -> Material {
    Material { name: name.into(), emitted: Rgb::splat(emitted), reflectance, texture: None }
}

/// A scene whose own units are those of the unit ball.
pub fn scene_of(surfaces: Vec<Surface>, materials: Vec<Material>) -> Scene {
    Scene { surfaces, materials, images: Vec::new(), fit: Fit { centre: DVec3::ZERO, radius: 1.0 } }
}

/// A rectangle with a corner and two perpendicular edges; its front looks along `a x b`.
pub fn quad(material: u32, corner: Vec3, a: Vec3, b: Vec3) -> Surface {
    Surface {
        material: MaterialId(material),
        normal: a.cross(b).normalize(),
        origin: corner,
        u: a.normalize(),
        v: b.normalize(),
        extent: Vec2::new(a.length(), b.length()),
        fineness: 0,
        polygons: vec![Polygon { vertices: vec![corner, corner + a, corner + a + b, corner + b] }],
        placement: None,
    }
}

/// The six walls of a cube of edge 1 about the origin, seen from within: -x, +x, -y, +y, -z, +z.
pub fn walls() -> Vec<Surface> {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let (low, high) = (Vec3::splat(-0.5), Vec3::splat(0.5));
    vec![
        quad(0, low, y, z),
        quad(0, high, -z, -y),
        quad(0, low, z, x),
        quad(0, high, -x, -z),
        quad(0, low, x, y),
        quad(0, high, -y, -x),
    ]
}

/// The cube of walls, white.
pub fn room() -> Scene {
    let white = material("white", 0.0, Reflectance::Diffuse(Rgb::splat(0.5)));
    scene_of(walls(), vec![white])
}

/// Rectangles strewn about, large and small.
pub fn soup(count: usize) -> Scene {
    let mut dice = Dice(1);
    let mut one = || {
        let corner = dice.point() * 0.9;
        let size = 0.3f32.powi((dice.roll() * 2.0 + 2.5) as i32);
        let a = dice.point().normalize() * size;
        let b = a.cross(dice.point()).normalize() * size * 0.5;
        quad(0, corner, a, b)
    };
    let surfaces = (0..count).map(|_| one()).collect();
    scene_of(surfaces, room().materials)
}
