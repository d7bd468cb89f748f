//! Total radiance maps of some of the lines, as the bake would make them, and how they differ from
//! those of the rehearsal's lines.

use super::links;
use super::rehearsal::{Generation, Rehearsal};
use crate::bake::BakeError;
use crate::bake::layers::Layers;
use crate::bake::marks::Marks;
use crate::bake::memory::Extent;
use crate::bake::reach;
use crate::bake::step::Shared;
use crate::bake::totals::{self, Mirrors};
use crate::directions::Directions;
use crate::field::FieldError;
use crate::format::container::{ALIGN, Codec, encode, length};
use crate::format::manifest::Parameters;
use crate::format::tiles::{Layout, TileMap};
use crate::ids::DirectionId;
use crate::pack::usual_size;
use crate::paths::{MAX_DEPTH, Paths};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::texels::Texels;
use crate::textured::Texture;
use crate::visible::Visible;
use rayon::prelude::*;
use std::path::Path;

/// Directions looked at, if there are so many.
const COUNT: usize = 128;

/// What some of the lines showed.
pub struct Sample {
    /// Directions looked at.
    pub count: u32,
    /// Fragments of a line, divided by those of a line of the rehearsal.
    pub fragments: f64,
    /// Mean bytes of a direction's file of total maps.
    pub file: f64,
    /// In a pack, without compression, with zstd, and as it is packed usually.
    pub packed: [f64; 3],
    /// Mean bytes of a PSF's links.
    pub links: f64,
    /// Most of any direction.
    pub most: Extent,
    /// Most bytes of a total map.
    pub largest: u64,
    /// Mean bytes of a direction's maps of mirrors by generation.
    pub generations: Vec<Generation>,
}

/// One direction.
struct Look {
    extent: Extent,
    links: u64,
    raw: u64,
    zstd: u64,
    usual: u64,
}

impl Sample {
    /// Looks at some directions, with as many threads as the bake.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub fn new(
        shared: &Shared,
        rehearsal: &Rehearsal,
        threads: usize,
    ) -> Result<Sample, BakeError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.max(1))
            .build()
            .map_err(|e| BakeError::Parameter(format!("--threads: {e}")))?;
        let curve = shared.directions.curve();
        let chosen: Vec<DirectionId> = chosen(curve.len()).into_iter().map(|k| curve[k]).collect();
        let mut lit = totals::lit_sides(shared.texels, &rehearsal.total);
        // More lines than the rehearsal's: its few leave parts of solids' insides open.
        let marks = pool.install(|| reach::marks(shared, &chosen, || true));
        let sides = sealed_sides(shared, &marks);
        lit.iter_mut().zip(&sides).for_each(|(lit, sealed)| {
            (0..2).for_each(|side| lit[side] &= !sealed[side]);
        });
        let follows = shared.has_mirrors() && !shared.parameters.totals_from_store();
        let visible = follows.then(|| Visible::new(shared.scene));
        let mirrors = visible.as_ref().map_or(Mirrors::None, |visible| {
            Mirrors::Traced(Paths { scene: shared.scene, visible, max_depth: MAX_DEPTH })
        });
        let Shared { scene, texels, exponent, .. } = *shared;
        let Parameters { resolution, tile, .. } = *shared.parameters;
        let surfaces = scene.surfaces.len() as u32;
        let part = f64::from(rehearsal.lines) / f64::from(shared.parameters.directions);
        let calm = calmed(texels, &rehearsal.total, part.powf(FALL) as f32);
        let texture = Texture { scene, texels, total: &calm };
        let look = |scratch: &mut (Layers, totals::Scratch), id: DirectionId| {
            let extent = extent(shared, id, &mut scratch.0);
            let links = links::bytes(shared, &marks, &mut scratch.0);
            let total = (calm.as_slice(), lit.as_slice());
            let map = totals::total_map(shared, id, total, (mirrors, &marks), &mut scratch.1);
            let failed = FieldError::io("encode", Path::new("total map"));
            let zstd = encode(Codec::Zstd, &map).map_err(failed)?.len() as u64;
            let layout = Layout::check(&map, resolution, tile, surfaces, exponent);
            let layout = layout.map_err(|fault| fault.in_file("total map"))?;
            let psf = Psf::new(shared.directions.vector(id), resolution);
            let tiles = TileMap::new(&map, &layout);
            let (usual, _) = usual_size(&tiles, (&psf, exponent), &texture, |_| true)?;
            Ok(Look { extent, links, raw: map.len() as u64, zstd, usual })
        };
        let looks = pool.install(|| {
            let looks = chosen.into_par_iter().map_init(Default::default, look);
            looks.collect::<Result<Vec<Look>, FieldError>>()
        })?;

        // The same of the rehearsal's lines.
        let coarse = Directions::with_lines(rehearsal.lines);
        let coarse = coarse.as_ref().unwrap_or(shared.directions);
        let parameters = &rehearsal.manifest.parameters;
        let few = Shared { directions: coarse, parameters, ..*shared };
        let ids: Vec<DirectionId> = coarse.ids().collect();
        let rehearsed: Vec<Extent> = pool.install(|| {
            let look = |layers: &mut Layers, id| extent(&few, id, layers);
            ids.into_par_iter().map_init(Layers::default, look).collect()
        });
        Ok(Sample::of(shared, rehearsal, &looks, &rehearsed))
    }

    fn of(shared: &Shared, rehearsal: &Rehearsal, looks: &[Look], rehearsed: &[Extent]) -> Sample {
        // Bytes of a map without entries.
        let tiles = u64::from(shared.parameters.resolution / shared.parameters.tile).pow(2);
        let empty = 16 + (4 * (tiles + 1)).next_multiple_of(8);
        let more = |e: &Extent| e.mirror_map.saturating_sub(48 + 4 * (tiles + 1)) as f64;
        let mean =
            |of: &mut dyn Iterator<Item = f64>, count: usize| of.sum::<f64>() / count.max(1) as f64;
        let of_looks = |f: &dyn Fn(&Look) -> f64| mean(&mut looks.iter().map(f), looks.len());
        let of_few =
            |f: &dyn Fn(&Extent) -> f64| mean(&mut rehearsed.iter().map(f), rehearsed.len());
        let (mirrors, few_mirrors) = (of_looks(&|l| more(&l.extent)), of_few(&more));
        let scale = if few_mirrors > 0.0 { mirrors / few_mirrors } else { 1.0 };
        let grown = |bytes: f64| (bytes - empty as f64).max(0.0) * scale + empty as f64;
        let generations = rehearsal.generations.iter().map(|g| Generation {
            unshot: grown(g.unshot),
            arrived: grown(g.arrived),
            values: g.values * scale,
        });
        let generations: Vec<Generation> = generations.collect();

        // The maps looked at lack what arrived at mirrors, if that is to come from their own maps.
        let stored = generations.last().filter(|_| shared.parameters.totals_from_store());
        let values = stored.map_or(0.0, |g| g.values);
        let arrived =
            |l: &Look| if mirrors > 0.0 { values * more(&l.extent) / mirrors } else { 0.0 };
        let raw = |l: &Look| (l.raw + arrived(l) as u64).next_multiple_of(8);
        let zstd = |l: &Look| l.zstd + (arrived(l) * rehearsal.ratios[1]) as u64;
        let usual = |l: &Look| l.usual + (arrived(l) * rehearsal.ratios[2]) as u64;
        let aligned = |bytes: u64| bytes.next_multiple_of(ALIGN as u64) as f64;
        Sample {
            count: looks.len() as u32,
            fragments: of_looks(&|l| l.extent.fragments as f64)
                / of_few(&|e| e.fragments as f64).max(1.0),
            file: of_looks(&|l| length([raw(l)].into_iter()) as f64),
            packed: [
                of_looks(&|l| aligned(raw(l))),
                of_looks(&|l| aligned(zstd(l))),
                of_looks(&|l| aligned(usual(l))),
            ],
            links: of_looks(&|l| l.links as f64),
            most: looks.iter().fold(Extent::default(), |most, l| most.most(l.extent)),
            largest: looks.iter().map(raw).max().unwrap_or(0),
            generations,
        }
    }
}

/// Which of so many directions along the curve are looked at: one in each of equal parts. Not at equal
/// distances: every fourth place of a Hilbert curve is the same corner of a square.
fn chosen(all: usize) -> Vec<usize> {
    // Of a few more than those, parts of unequal length would be looked at too often.
    let count = if all <= 2 * COUNT { all } else { COUNT };
    let place = |k: usize| {
        let inside = (k as f64 * 0.618_033_988_75).fract();
        ((k as f64 + inside) * all as f64 / count as f64) as usize
    };
    if count == all { (0..all).collect() } else { (0..count).map(place).collect() }
}

/// A texture map of few lines with as little noise as more would leave in it: what a texel differs by
/// from the mean around it is mostly noise. `part` is what is left of it.
fn calmed(texels: &Texels, total: &[Rgb], part: f32) -> Vec<Rgb> {
    let mut calm = total.to_vec();
    if part >= 1.0 {
        return calm;
    }
    for lattice in texels.lattices.iter().filter(|lattice| lattice.first < texels.diffuse) {
        let around = |at: u32, end: u32| at.saturating_sub(AROUND)..(at + AROUND + 1).min(end);
        let value = |column: u32, row: u32, side: usize| {
            2 * (lattice.first + row * lattice.width + column) as usize + side
        };
        for (row, column) in
            (0..lattice.height).flat_map(|r| (0..lattice.width).map(move |c| (r, c)))
        {
            let (rows, columns) = (around(row, lattice.height), around(column, lattice.width));
            let count = (rows.len() * columns.len()) as f32;
            for side in 0..2 {
                let of_row =
                    |r| columns.clone().map(move |c| total[value(c, r, side)]).sum::<Rgb>();
                let mean = rows.clone().map(of_row).sum::<Rgb>() / count;
                let at = value(column, row, side);
                calm[at] = mean * (1.0 - part) + total[at] * part;
            }
        }
    }
    calm
}

/// How noise falls with the number of lines: as its power by this. They are spread evenly, so that it
/// falls faster than with the root. Measured by what packs of 2049 lines then take.
const FALL: f64 = 0.75;

/// Texels to each side that a mean is taken of.
const AROUND: u32 = 2;

/// The sides of surfaces that no light can come to anywhere.
fn sealed_sides(shared: &Shared, marks: &Marks) -> Vec<[bool; 2]> {
    let mut sides = vec![[true; 2]; shared.scene.surfaces.len()];
    for (texel, surface) in shared.texels.surface_of.iter().enumerate() {
        for (side, all) in sides[*surface as usize].iter_mut().enumerate() {
            *all &= marks.is_sealed(2 * texel + side);
        }
    }
    sides
}

/// What a direction takes, with every side lit.
fn extent(shared: &Shared, id: DirectionId, layers: &mut Layers) -> Extent {
    let psf = Psf::new(shared.directions.vector(id), shared.parameters.resolution);
    layers.rasterise(shared.outlines, &psf);
    Extent::of(shared, id, layers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_looked_at_are_spread_and_none_is_taken_twice() {
        for all in [1, 9, 33, 128, 129, 513, 2049, 8193] {
            let places = chosen(all);
            assert_eq!(places.len(), if all <= 2 * COUNT { all } else { COUNT });
            assert!(places.windows(2).all(|w| w[0] < w[1]), "{all}: {places:?}");
            assert!(places.iter().all(|p| *p < all), "{all}: {places:?}");
        }
    }
}
