//! The second method of section 6: diffuse surfaces from the Total Texture Map, mirrors by rays.
//!
//! In: the texture maps P^T and a hit of an eye ray. Out: its radiance, over the path `E S* D`.

use super::Look;
use crate::ids::SurfaceId;
use crate::level::level;
use crate::look::packet::{LANES, Lanes, NONE, Packet};
use crate::paths::Paths;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::{self, Places, Texels};
use crate::visible::Hit;
use fearless_simd::{Simd, dispatch, f32x16, prelude::*};
use glam::{Vec2, Vec3};

/// Everything that the method looks at.
#[derive(Clone, Copy)]
pub struct Raytrace<'a> {
    /// The scene's paths.
    pub paths: Paths<'a>,
    /// Where the texture maps lie.
    pub texels: &'a Texels,
    /// P^T, two values a texel (see [`texels::sample`]), emission included, W sr^-1 m^-2.
    pub values: &'a [Rgb],
}

impl Raytrace<'_> {
    /// Radiance from a hit along the unit direction `dir`, which points from the eye to the hit.
    /// W sr^-1 m^-2.
    pub fn radiance(&self, dir: Vec3, hit: &Hit) -> Rgb {
        self.paths.radiance(dir, hit, true, |at| {
            let surface = self.paths.scene.surface(at.surface);
            texels::sample(self.texels, self.values, at.surface, surface, at.side, at.point)
        })
    }
}

impl Look for Raytrace<'_> {
    fn radiance(&mut self, dir: Vec3, hit: &Hit) -> Rgb {
        Raytrace::radiance(self, dir, hit)
    }

    fn packet(&mut self, packet: &Packet, out: &mut Lanes<Rgb>) {
        dispatch!(level(), simd => self.packet_with(simd, packet, out));
    }

    /// Not mirrors, which show edges of other surfaces.
    fn plain(&self, quarters: &[Packet; 4]) -> u32 {
        let Raytrace { paths: Paths { scene, .. }, texels, .. } = self;
        plain_pixels(quarters, |hits| {
            let is_mirror = scene.material_of(hits[0].surface).reflectance.is_mirror();
            !is_mirror && is_even(scene, texels, hits)
        })
    }
}

/// The pixels whose quarters meet a surface that is `plain` there, as a bit each.
pub(super) fn plain_pixels(quarters: &[Packet; 4], plain: impl Fn([Hit; 4]) -> bool) -> u32 {
    let hits = |k| {
        let [a, b, c, d] = quarters;
        Some([a.hit(k)?, b.hit(k)?, c.hit(k)?, d.hit(k)?])
    };
    let is_plain = |k: &usize| hits(*k).is_some_and(&plain);
    (0..LANES).filter(is_plain).fold(0, |bits, k| bits | 1 << k)
}

/// Whether a pixel, whose quarters have met a surface, shows no more than a texel of it, and no cut.
pub(super) fn is_even(scene: &Scene, texels: &Texels, hits: [Hit; 4]) -> bool {
    let (id, surface) = (hits[0].surface, scene.surface(hits[0].surface));
    let lattice = &texels.lattices[id.index()];
    let places = hits.map(|hit| surface.coordinates(hit.point) * lattice.density);
    let low = places.into_iter().fold(places[0], Vec2::min);
    let high = places.into_iter().fold(places[0], Vec2::max);
    // The pixel's corners are twice as far apart as its quarters' middles.
    let around = 0.5 * (high - low);
    let is_small = (4.0 * around).max_element() <= 1.0;
    is_small && !texels.is_near_cut(lattice, low - around, high + around)
}

impl Raytrace<'_> {
    /// Mirrors' rays part ways and go one by one.
    #[inline(always)]
    fn packet_with<S: Simd>(&self, simd: S, packet: &Packet, out: &mut Lanes<Rgb>) {
        let Raytrace { paths, texels, values } = self;
        let [x, y, z] = packet.points();
        let points =
            [f32x16::simd_from(simd, *x), f32x16::simd_from(simd, *y), f32x16::simd_from(simd, *z)];
        let mut before = (NONE, None);
        for (k, (out, surface)) in out.iter_mut().zip(packet.surfaces).enumerate() {
            if surface == NONE {
                *out = Rgb::BLACK;
                continue;
            }
            if before.0 != surface {
                let id = SurfaceId(surface);
                let is_mirror = paths.scene.material_of(id).reflectance.is_mirror();
                let on = (id, paths.scene.surface(id));
                let places = (!is_mirror).then(|| Places::new(simd, texels, on, points));
                before = (surface, places);
            }
            *out = match (&before.1, packet.hit(k)) {
                (Some(places), _) => places.sample(texels, values, packet.side(k), k),
                (None, Some(hit)) => Raytrace::radiance(self, packet.dir(k), &hit),
                (None, None) => Rgb::BLACK,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{MaterialId, SurfaceId};
    use crate::paths::MAX_DEPTH;
    use crate::scene::test_scenes::{Dice, material, quad, room, scene_of};
    use crate::scene::{Reflectance, Scene, Surface};
    use crate::visible::Visible;

    /// The room with walls of material 0 (diffuse) and those numbered in `mirrors` of material 1.
    fn with_mirrors(mirrors: &[usize], factor: f32, emitted: f32) -> Scene {
        let mut scene = room();
        scene.materials.push(material("m", emitted, Reflectance::Mirror(Rgb::splat(factor))));
        for m in mirrors {
            scene.surfaces[*m].material = MaterialId(1);
        }
        scene
    }

    /// A value for each texel and side that tells which one it is.
    fn numbered(texels: &Texels) -> Vec<Rgb> {
        (0..2 * texels.len()).map(|i| Rgb([i as f32, 1.0, 0.0])).collect()
    }

    fn look(scene: &Scene, values: impl Fn(&Texels) -> Vec<Rgb>, from: Vec3, dir: Vec3) -> Rgb {
        let visible = Visible::new(scene);
        let texels = Texels::new(scene, 0.125);
        let values = values(&texels);
        let paths = Paths { scene, visible: &visible, max_depth: MAX_DEPTH };
        let method = Raytrace { paths, texels: &texels, values: &values };
        method.radiance(dir, &visible.nearest(from, dir, 0.0).unwrap())
    }

    #[test]
    fn a_diffuse_wall_shows_its_texel() {
        let scene = with_mirrors(&[], 1.0, 0.0);
        let texels = Texels::new(&scene, 0.125);
        let target = Vec3::new(-0.5, 0.1875, -0.3125);
        let seen = look(&scene, numbered, Vec3::ZERO, target.normalize());
        let texel = texels.at(SurfaceId(0), &scene.surfaces[0], target);
        assert!((seen.0[0] - 2.0 * texel as f32).abs() < 1e-3, "{seen:?}, texel {texel}");
    }

    #[test]
    fn a_mirror_shows_the_texel_behind_which_the_image_stands() {
        // From the origin to the mirror x = 0.5 and back to the wall x = -0.5: the image of that wall
        // stands at x = 1.5, so the target's image is where the unfolded ray ends.
        let scene = with_mirrors(&[1], 0.5, 0.0);
        let texels = Texels::new(&scene, 0.125);
        let target = Vec3::new(-0.5, 0.1875, -0.3125);
        let image = Vec3::new(1.5, target.y, target.z);
        let seen = look(&scene, numbered, Vec3::ZERO, image.normalize());
        let texel = texels.at(SurfaceId(0), &scene.surfaces[0], target);
        assert!((seen.0[0] - 0.5 * 2.0 * texel as f32).abs() < 1e-2, "{seen:?}, texel {texel}");
        assert!((seen.0[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn facing_mirrors_sum_their_geometric_series() {
        // Six mirrors of reflectance 0.5 that emit 1: 1 + 1/2 + 1/4 + ... = 2 along every ray.
        let scene = with_mirrors(&[0, 1, 2, 3, 4, 5], 0.5, 1.0);
        let mut dice = Dice(3);
        for _ in 0..200 {
            let seen = look(&scene, numbered, dice.point() * 0.8, dice.point().normalize());
            assert!((seen.0[0] - 2.0).abs() < 1e-3, "{seen:?}");
        }
    }

    #[test]
    fn no_ray_leaves_a_closed_room_through_a_corner() {
        // Perfect mirrors but for one white wall: a path that left the room would find black. Aim at
        // the corners of the mirrors, and let no bound on the depth end a path.
        let scene = with_mirrors(&[0, 1, 2, 3], 1.0, 0.0);
        let visible = Visible::new(&scene);
        let texels = Texels::new(&scene, 0.5);
        let values = vec![Rgb::splat(1.0); 2 * texels.len()];
        let paths = Paths { scene: &scene, visible: &visible, max_depth: 10_000 };
        let trace = Raytrace { paths, texels: &texels, values: &values };
        let mut dice = Dice(9);
        for i in 0..20_000 {
            let near = 10f32.powi(-(i % 8));
            let corner = Vec3::new(0.5, -0.5, dice.roll() * 0.45) + dice.point() * near * 0.1;
            let mut dir = corner.clamp(Vec3::splat(-0.5), Vec3::splat(0.5)) - Vec3::Z * 0.4;
            // Down the room fast enough to end within the bound.
            dir.z = dir.z.abs().max(0.02);
            let dir = (dir * Vec3::new(1.0, 1.0, -1.0)).normalize();
            let hit = visible.nearest(Vec3::Z * 0.4, dir, 0.0).unwrap();
            assert_eq!(trace.radiance(dir, &hit), Rgb::splat(1.0), "ray {i}: {dir} {hit:?}");
        }
    }

    #[test]
    fn the_back_of_a_mirror_reflects_but_does_not_emit() {
        let plate = |at: f32, m| quad(m, Vec3::new(-0.5, -0.5, at), Vec3::X, Vec3::Y);
        let surfaces: Vec<Surface> = vec![plate(0.2, 1), plate(-0.5, 0)];
        let mut scene = scene_of(surfaces, room().materials);
        scene.materials.push(material("m", 3.0, Reflectance::Mirror(Rgb::splat(0.5))));
        let ones = |t: &Texels| vec![Rgb::splat(1.0); 2 * t.len()];
        assert_eq!(look(&scene, ones, Vec3::ZERO, Vec3::Z), Rgb::splat(0.5));
        assert_eq!(look(&scene, ones, Vec3::Z * 0.5, -Vec3::Z), Rgb::splat(3.0));
    }
}
