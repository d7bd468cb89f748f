//! Diffuse reflectance of every texel: a surface's own, or the mean of its image over the texel.
//!
//! Means are taken from tables of sums (Crow 1984), so that a texel costs the same however many pixels
//! it covers. A texel whose edges run along the image's is a box in it, and its mean is exact; another
//! is divided into smaller boxes.

use super::image::{self, Image};
use super::texels::{Lattice, Texels};
use super::{Placement, Reflectance, Scene, Texture};
use crate::ids::SurfaceId;
use crate::radiance::Rgb;
use glam::DVec2;
use rayon::prelude::*;

/// Boxes along each edge of a texel that lies askew in its image.
const PARTS: u32 = 8;

/// Boxes smaller than this, in pixels, are taken to be as large.
const LEAST: f64 = 1.0 / 64.0;

/// Periods of an image beyond which nothing of its rhythm is left.
const MOST: f64 = 1e5;

/// Where a surface has no values of its own.
const PLAIN: u32 = u32::MAX;

/// Diffuse reflectances of a scene's texels; mirrors have none.
pub struct Reflectances {
    /// Of each surface, where it is one for all texels.
    plain: Vec<Rgb>,
    /// Where the values of a textured surface begin, less its first texel; [`PLAIN`] for others.
    begins: Vec<u32>,
    values: Vec<Rgb>,
}

impl Reflectances {
    /// Those of all texels. Besides what stays, it takes [`Reflectances::passing_bytes`].
    pub fn new(scene: &Scene, texels: &Texels) -> Reflectances {
        let plain = |id| match scene.material_of(id).reflectance {
            Reflectance::Diffuse(rho) => rho,
            Reflectance::Mirror(_) => Rgb::BLACK,
        };
        let plain: Vec<Rgb> = scene.surface_ids().map(plain).collect();
        let mut begins = vec![PLAIN; if scene.images.is_empty() { 0 } else { plain.len() }];
        let mut count = 0;
        for (id, ..) in textured(scene) {
            begins[id.index()] = count as u32;
            count += texels.lattices[id.index()].len();
        }
        let mut values = vec![Rgb::BLACK; count];
        for (number, image) in scene.images.iter().enumerate() {
            let shown = || textured(scene).filter(|(_, texture, _)| texture.image == number as u32);
            if shown().next().is_none() {
                continue;
            }
            for channel in 0..3 {
                let sums = Sums::new(image, channel);
                for (id, texture, placement) in shown() {
                    let lattice = &texels.lattices[id.index()];
                    let footprint = Footprint::new(image, placement, lattice);
                    let tint = f64::from(texture.tint.0[channel]);
                    let begin = begins[id.index()] as usize;
                    let own = &mut values[begin..begin + lattice.len()];
                    own.par_iter_mut().enumerate().for_each(|(k, value)| {
                        let (column, row) = (k as u32 % lattice.width, k as u32 / lattice.width);
                        let mean = footprint.mean(&sums, texture.clamp, (column, row));
                        value.0[channel] = (tint * mean).clamp(0.0, 1.0) as f32;
                    });
                }
            }
        }
        Reflectances { plain, begins, values }
    }

    /// Of a surface whose texels reflect alike; `None` where each has its own.
    pub fn of(&self, id: SurfaceId) -> Option<Rgb> {
        let is_plain = self.begins.get(id.index()).is_none_or(|b| *b == PLAIN);
        is_plain.then(|| self.plain[id.index()])
    }

    /// Of a texel of a surface, counted from the surface's first.
    pub fn at(&self, id: SurfaceId, texel: usize) -> Rgb {
        match self.begins.get(id.index()) {
            Some(&begin) if begin != PLAIN => self.values[begin as usize + texel],
            _ => self.plain[id.index()],
        }
    }

    /// Bytes that they take: those of a scene's texels, without making them.
    pub fn bytes(scene: &Scene, texels: &Texels) -> u64 {
        let own = textured(scene).map(|(id, ..)| 12 * texels.lattices[id.index()].len() as u64);
        12 * scene.surfaces.len() as u64 + own.sum::<u64>()
    }

    /// Bytes that making them takes for a while.
    pub fn passing_bytes(scene: &Scene) -> u64 {
        scene.images.iter().map(Sums::bytes).max().unwrap_or(0)
    }
}

/// The surfaces whose texels differ.
fn textured(scene: &Scene) -> impl Iterator<Item = (SurfaceId, Texture, &Placement)> {
    scene.surface_ids().filter_map(|id| {
        Some((id, scene.material_of(id).texture?, scene.surface(id).placement.as_deref()?))
    })
}

/// Sums of one channel of an image over all pixels above and to the left.
struct Sums {
    width: usize,
    height: usize,
    /// `(width + 1) (height + 1)` sums, row by row, in parts of [`image::ONE`].
    sums: Vec<u64>,
}

impl Sums {
    fn new(image: &Image, channel: usize) -> Sums {
        let (width, height) = (image.width as usize, image.height as usize);
        let mut sums = vec![0; (width + 1) * (height + 1)];
        for (row, pixels) in image.pixels.chunks_exact(width).enumerate() {
            let (above, below) = sums.split_at_mut((row + 1) * (width + 1));
            let above = &above[row * (width + 1)..];
            let mut sum = 0;
            for (column, pixel) in pixels.iter().enumerate() {
                sum += u64::from(image::linear(pixel[channel]));
                below[column + 1] = above[column + 1] + sum;
            }
        }
        Sums { width, height, sums }
    }

    fn bytes(image: &Image) -> u64 {
        8 * (u64::from(image.width) + 1) * (u64::from(image.height) + 1)
    }

    /// The integral of the image from its beginning to a place in pixels inside it.
    fn within(&self, place: DVec2) -> f64 {
        let column = (place.x as usize).min(self.width - 1);
        let row = (place.y as usize).min(self.height - 1);
        let (x, y) = (place.x - column as f64, place.y - row as f64);
        let at = |c: usize, r: usize| self.sums[r * (self.width + 1) + c] as f64;
        let upper = at(column, row) * (1.0 - x) + at(column + 1, row) * x;
        let lower = at(column, row + 1) * (1.0 - x) + at(column + 1, row + 1) * x;
        upper * (1.0 - y) + lower * y
    }

    /// The same to any place to the right and below, of the image repeated.
    fn repeated(&self, place: DVec2) -> f64 {
        let size = DVec2::new(self.width as f64, self.height as f64);
        let periods = (place / size).floor();
        let rest = (place - periods * size).clamp(DVec2::ZERO, size);
        periods.x * periods.y * self.within(size)
            + periods.x * self.within(DVec2::new(size.x, rest.y))
            + periods.y * self.within(DVec2::new(rest.x, size.y))
            + self.within(rest)
    }

    /// The mean over a box of pixels, in [0, 1].
    fn mean(&self, middle: DVec2, size: DVec2, clamp: [bool; 2]) -> f64 {
        let image = DVec2::new(self.width as f64, self.height as f64);
        let size = size.max(DVec2::splat(LEAST));
        let (mut low, mut high) = (middle - 0.5 * size, middle + 0.5 * size);
        for axis in [0, 1] {
            let edge = image[axis];
            if clamp[axis] {
                // What is left of the box inside, or the outermost pixel.
                low[axis] = low[axis].clamp(0.0, edge - LEAST);
                high[axis] = high[axis].clamp(low[axis] + LEAST, edge);
            } else if size[axis] > MOST * edge {
                (low[axis], high[axis]) = (0.0, edge);
            } else {
                let before = (low[axis] / edge).floor() * edge;
                low[axis] = (low[axis] - before).max(0.0);
                high[axis] -= before;
            }
        }
        let is_inside = high.cmple(image).all();
        let over = |x: f64, y: f64| {
            let place = DVec2::new(x, y);
            if is_inside { self.within(place) } else { self.repeated(place) }
        };
        let sum =
            over(high.x, high.y) - over(low.x, high.y) - over(high.x, low.y) + over(low.x, low.y);
        sum / ((high.x - low.x) * (high.y - low.y) * f64::from(image::ONE))
    }
}

/// What texels of a surface cover of its image, in pixels.
struct Footprint {
    origin: DVec2,
    /// What a column and a row of texels add.
    column: DVec2,
    row: DVec2,
    /// Boxes along each edge of a texel, and the size of one.
    parts: u32,
    size: DVec2,
}

impl Footprint {
    fn new(image: &Image, placement: &Placement, lattice: &Lattice) -> Footprint {
        let pixels = DVec2::new(f64::from(image.width), f64::from(image.height));
        let density = lattice.density.as_dvec2();
        let column = placement.along_u.as_dvec2() * pixels / density.x;
        let row = placement.along_v.as_dvec2() * pixels / density.y;
        // The box around a texel, and what part of it the texel is.
        let around = column.abs() + row.abs();
        let area = (column.perp_dot(row)).abs();
        let part = area / (around.x * around.y);
        // Less than a part of a thousand askew is not askew.
        let parts = if part.is_nan() || part > 0.999 { 1 } else { PARTS };
        let shrunk = if part.is_nan() { 1.0 } else { part.sqrt() };
        let size = around * shrunk / f64::from(parts);
        Footprint { origin: placement.origin.as_dvec2() * pixels, column, row, parts, size }
    }

    /// The mean of a channel over a texel.
    fn mean(&self, sums: &Sums, clamp: [bool; 2], (column, row): (u32, u32)) -> f64 {
        let mut sum = 0.0;
        let step = 1.0 / f64::from(self.parts);
        for part in 0..self.parts * self.parts {
            let a = f64::from(column) + (f64::from(part % self.parts) + 0.5) * step;
            let b = f64::from(row) + (f64::from(part / self.parts) + 0.5) * step;
            let middle = self.origin + self.column * a + self.row * b;
            sum += sums.mean(middle, self.size, clamp);
        }
        sum * step * step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{material, quad, scene_of};
    use glam::{Vec2, Vec3};

    /// Pixels without a rhythm.
    fn speckled(width: u32, height: u32) -> Image {
        let pixel =
            |k: u32| [0, 1, 2].map(|c| (k.wrapping_mul(2_654_435_761) >> (8 + 7 * c)) as u8);
        Image { width, height, pixels: (0..width * height).map(pixel).collect() }
    }

    /// The reflectances of a square of edge 1 with an image on it, and its lattice.
    fn square(image: Image, clamp: bool, placement: Placement, edge: f32) -> (Vec<Rgb>, Lattice) {
        let tint = Rgb([1.0, 0.5, 0.25]);
        let mean = Reflectance::Diffuse(image.mean() * tint);
        let mut textured = material("textured", 0.0, mean);
        textured.texture = Some(Texture { image: 0, tint, clamp: [clamp; 2] });
        let mut surface = quad(0, Vec3::splat(-0.5), Vec3::X, Vec3::Y);
        surface.placement = Some(Box::new(placement));
        let mut scene = scene_of(vec![surface], vec![textured]);
        scene.images = vec![image];
        let texels = Texels::new(&scene, edge);
        let reflectances = Reflectances::new(&scene, &texels);
        let lattice = texels.lattices[0];
        let all = (0..lattice.len()).map(|k| reflectances.at(SurfaceId(0), k)).collect();
        assert_eq!(Reflectances::bytes(&scene, &texels), 12 + 12 * lattice.len() as u64);
        (all, lattice)
    }

    /// The mean of an image over a texel by very many points.
    fn by_points(image: &Image, clamp: bool, on: Placement, lattice: &Lattice, texel: u32) -> Rgb {
        const POINTS: u32 = 400;
        let (column, row) = (texel % lattice.width, texel / lattice.width);
        let mut sums = [0.0; 3];
        for k in 0..POINTS * POINTS {
            let within =
                |k: u32, first: u32| f64::from(first) + (f64::from(k) + 0.5) / f64::from(POINTS);
            let (a, b) = (within(k % POINTS, column), within(k / POINTS, row));
            let (a, b) = (a / f64::from(lattice.density.x), b / f64::from(lattice.density.y));
            let place =
                on.origin.as_dvec2() + on.along_u.as_dvec2() * a + on.along_v.as_dvec2() * b;
            let pixel = |x: f64, edge: u32| {
                let x = if clamp { x.clamp(0.0, 1.0) } else { x - x.floor() };
                ((x * f64::from(edge)) as u32).min(edge - 1)
            };
            let at = pixel(place.y, image.height) * image.width + pixel(place.x, image.width);
            let found = image.pixels[at as usize];
            (0..3).for_each(|c| sums[c] += f64::from(image::linear(found[c])));
        }
        let count = f64::from(image::ONE) * f64::from(POINTS * POINTS);
        Rgb([0, 1, 2].map(|c| (sums[c] / count) as f32)) * Rgb([1.0, 0.5, 0.25])
    }

    fn placement(origin: (f32, f32), along_u: (f32, f32), along_v: (f32, f32)) -> Placement {
        let [origin, along_u, along_v] = [origin, along_u, along_v].map(Vec2::from);
        Placement { origin, along_u, along_v }
    }

    #[test]
    fn a_texel_reflects_the_mean_of_what_it_covers() {
        let image = speckled(96, 64);
        // Minified, along the axes and turned, mirrored, repeated; magnified; askew.
        for (on, edge, clamp, most) in [
            (placement((0.0, 1.0), (1.0, 0.0), (0.0, -1.0)), 0.25, false, 2e-3),
            (placement((0.3, 0.1), (0.0, 3.7), (-2.2, 0.0)), 0.25, false, 2e-3),
            (placement((0.1, 0.1), (0.8, 0.8), (-0.8, 0.8)), 0.25, false, 5e-3),
            (placement((0.1, 0.1), (2.0, 1.0), (0.5, 3.0)), 0.5, false, 5e-3),
            (placement((0.5, 0.5), (0.01, 0.0), (0.0, 0.02)), 0.25, false, 5e-3),
            (placement((-0.5, 0.0), (2.0, 0.0), (0.0, 1.0)), 0.25, true, 2e-3),
        ] {
            let (found, lattice) = square(image.clone(), clamp, on, edge);
            for texel in 0..lattice.len() as u32 {
                let expected = by_points(&image, clamp, on, &lattice, texel);
                for c in 0..3 {
                    let off = found[texel as usize].0[c] - expected.0[c];
                    assert!(off.abs() < most, "{on:?} {texel}: {off}");
                }
            }
        }
    }

    #[test]
    fn no_placement_is_too_large_or_too_small() {
        let image = speckled(5, 3);
        let mean = image.mean() * Rgb([1.0, 0.5, 0.25]);
        for size in [0.0, 1e-20, 1e9] {
            let on = placement((0.5, 0.5), (size, 0.0), (0.0, size));
            let askew = placement((-0.5, 1e9), (size, size), (-size, size));
            for (on, clamp) in [(on, false), (on, true), (askew, false), (askew, true)] {
                let (found, _) = square(image.clone(), clamp, on, 0.5);
                assert!(found.iter().all(|v| v.is_physical() && v.max() <= 1.0), "{on:?}");
                if size > 1.0 && !clamp {
                    let off = (found[0].mean() - mean.mean()).abs();
                    assert!(off < 1e-2, "nothing is left but the mean: {off}");
                }
            }
        }
    }
}
