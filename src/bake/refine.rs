//! Texels' resolution: finer on surfaces whose light has edges (section 5 leaves their size open).
//!
//! In: a scene and what it is to be baked with. Out: the scene, each surface with a
//! [`fineness`](crate::scene::Surface::fineness). A *pilot*, a small bake in memory of the first two bounces, shows
//! which surfaces wash edges of shadows and caustics out; texels go where they mend most. A pure
//! function of scene and parameters, so that a bake that is taken up again comes to the same texels.

use super::cycle::Bake;
use super::estimate::Errors;
use super::{BakeError, Options, checked, needs, texels};
use crate::field::storage::memory::Memory;
use crate::field::{Field, Terms};
use crate::format::limits::FINENESS;
use crate::format::manifest::{Parameters, Specular};
use crate::format::tiles::exponent_for;
use crate::ids::SurfaceId;
use crate::scene::Scene;
use crate::scene::texels::size;
use std::borrow::Cow;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::sync::Arc;

/// Most lines, and cells along the edge of a grid, of the pilot.
const PILOT: (u32, u32) = (129, 128);

/// Grids of the pilot's two cycles: small lamps take many of them in little time.
const GRIDS: [u32; 2] = [64, 2];

/// Its texels are so much coarser, for as many lines in each as noise does not hide edges.
const COARSER: f64 = 2.0;

/// What is washed out on a surface may spoil so much of a picture, relMSE, before its texels are made finer.
const SPOILT: f64 = 2e-5;

/// Where a light's edges are steps, halving texels halves the squared error that they make.
const HALVED: f64 = 0.5;

/// The scene with texels as fine as `parameters` let them be; `None` when asked to stop.
///
/// # Errors
/// What can go wrong with a small bake.
pub fn refined<'a>(
    scene: &'a Scene,
    parameters: &Parameters,
    options: &Options,
) -> Result<Option<Cow<'a, Scene>>, BakeError> {
    if parameters.refined <= 1.0 {
        return Ok(Some(Cow::Borrowed(scene)));
    }
    let Some(errors) = pilot(scene, parameters, options)? else { return Ok(None) };
    let mut scene = scene.clone();
    let edge = parameters.texel_edge();
    for (surface, fineness) in fineness(&scene, edge, &errors, parameters.refined) {
        scene.surfaces[surface.index()].fineness = fineness;
    }
    Ok(Some(Cow::Owned(scene)))
}

/// What is wrong with each surface after two cycles of few lines.
fn pilot(
    scene: &Scene,
    parameters: &Parameters,
    options: &Options,
) -> Result<Option<Vec<Errors>>, BakeError> {
    let (lines, cells) = PILOT;
    let resolution = parameters.resolution.min(cells.next_multiple_of(parameters.tile));
    let parameters = Parameters {
        directions: parameters.directions.min(lines),
        resolution,
        cycles: Some(GRIDS.len() as u32),
        perturbations: GRIDS.to_vec(),
        thinned: 0,
        texel_cells: parameters.texel_cells * COARSER,
        refined: 1.0,
        supersample: false,
        filter: parameters.filter.min(1) + 1,
        target_error: 0.0,
        specular: Specular::Trace,
        resample: true,
        ..parameters.clone()
    };
    let directions = checked(scene, &parameters)?;
    let texels = texels(scene, &parameters);
    let most = scene.materials.iter().map(|m| m.emitted.max()).fold(0.0, f32::max);
    let exponent = exponent_for(most);
    let options = Options {
        progress: &|_| (),
        order: None,
        commit_every: f64::INFINITY,
        terms: Terms { sync: false, lock: false },
        ..*options
    };
    let (need, _) = needs(scene, &texels, &directions, &parameters, exponent, &options)?;
    let storage = Arc::new(Memory::with_capacity(u64::MAX));
    let field = Field::create_or_resume(storage, scene, &parameters, exponent, options.terms)?;
    Bake::new(scene, &texels, &directions, field, (most, need), &options)?.errors()
}

/// A surface whose texels may be made finer.
#[derive(PartialEq)]
struct Candidate {
    /// relMSE of pictures that another halving would take away, for each texel that it takes.
    gain: f64,
    spoilt: f64,
    surface: SurfaceId,
    fineness: u8,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Candidate) -> Ordering {
        self.gain.total_cmp(&other.gain).then(other.surface.cmp(&self.surface))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Candidate) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Which surfaces get finer texels: those first that gain most by each, until there are `most` times as
/// many texels, or no surface spoils pictures.
fn fineness(scene: &Scene, edge: f32, errors: &[Errors], most: f64) -> Vec<(SurfaceId, u8)> {
    // But for rounding, the more that there are of small surfaces.
    let count = |surface: SurfaceId, fineness: u8| {
        let [width, height] = size(scene.surface(surface).extent, 0, edge);
        f64::from(width) * f64::from(height) * 4f64.powi(fineness.into())
    };
    let area: f64 = errors.iter().map(|e| e.area).sum();
    let candidate = |surface, fineness, spoilt: f64| {
        let added = count(surface, fineness + 1) - count(surface, fineness);
        Candidate { gain: spoilt * (1.0 - HALVED) / added, spoilt, surface, fineness }
    };
    let mut room = (most - 1.0) * errors.iter().map(|e| count(e.surface, 0)).sum::<f64>();
    let mut open: BinaryHeap<Candidate> =
        errors.iter().map(|e| candidate(e.surface, 0, e.washed_out / area)).collect();
    let mut finer = Vec::new();
    while let Some(Candidate { spoilt, surface, fineness, .. }) = open.pop() {
        let added = count(surface, fineness + 1) - count(surface, fineness);
        if spoilt < SPOILT || added > room {
            continue;
        }
        room -= added;
        finer.push((surface, fineness + 1));
        if fineness + 1 < FINENESS {
            open.push(candidate(surface, fineness + 1, spoilt * HALVED));
        }
    }
    finer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{quad, scene_of};
    use glam::Vec3;
    use std::sync::atomic::AtomicBool;

    /// A large and a small square, and what a pilot says is washed out on them.
    fn squares(washed_out: [f64; 2]) -> (Scene, Vec<Errors>) {
        let square = |z: f32, a: f32| quad(0, Vec3::Z * z, Vec3::X * a, Vec3::Y * a);
        let scene = scene_of(vec![square(-0.5, 0.8), square(0.5, 0.2)], Vec::new());
        let errors = (0..2).map(|k: usize| {
            let area = f64::from(scene.surfaces[k].area());
            let surface = SurfaceId(k as u32);
            Errors { surface, texels: 1, area, noise: 0.1, washed_out: washed_out[k] }
        });
        let errors = errors.collect();
        (scene, errors)
    }

    fn levels(washed_out: [f64; 2], most: f64) -> [u8; 2] {
        let (scene, errors) = squares(washed_out);
        let mut levels = [0, 0];
        for (surface, fineness) in fineness(&scene, 0.01, &errors, most) {
            levels[surface.index()] = fineness;
        }
        levels
    }

    #[test]
    fn texels_go_where_they_mend_most_and_no_further_than_allowed() {
        assert_eq!(levels([0.0, 0.0], 64.0), [0, 0], "even light needs none");
        assert_eq!(levels([0.1, 0.0], 1.0), [0, 0]);
        assert_eq!(levels([0.1, 0.0], 4.0), [1, 0]);
        // The small one, a sixteenth of the area, takes few for as much: three halvings for what one
        // of the large one would take.
        assert_eq!(levels([0.01, 0.01], 3.0), [0, 2]);
        let all = levels([0.1, 0.1], 64.0);
        assert!(all[0] >= 2 && all[1] == FINENESS, "{all:?}");
    }

    #[test]
    fn shadows_make_a_floor_finer_and_leave_even_walls_as_they_are() {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let parameters = Parameters {
            directions: 513,
            resolution: 64,
            tile: 16,
            texel_cells: 0.5,
            refined: 4.0,
            ..Parameters::default()
        };
        let options = Options {
            memory: 1 << 30,
            threads: 2,
            stop: &AtomicBool::new(false),
            progress: &|_| (),
            order: None,
            commit_every: 5.0,
            terms: Terms::default(),
            force: false,
        };
        let fine = refined(&scene, &parameters, &options).unwrap().unwrap();
        let again = refined(&scene, &parameters, &Options { threads: 1, ..options }).unwrap();
        assert_eq!(*fine, *again.unwrap(), "whatever the threads");
        // The blocks' shadows fall on the floor, surface 0.
        assert!(fine.surfaces[0].fineness > 0);
        let finer = fine.surfaces.iter().filter(|s| s.fineness > 0).count();
        assert!(finer < fine.surfaces.len() / 2, "{finer}");
    }
}
