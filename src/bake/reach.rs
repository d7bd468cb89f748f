//! Reach: which sides of which texels no light can come to.
//!
//! In: the scene's outlines and lines. Out: the sealed values: insides of closed boxes, floors under
//! boxes, outsides of a room's walls. They take part in most of the exchanges of a scene and in none of
//! its light. Pairs with a sealed end are left out of every cycle: that is fast, and a texel on which a
//! box's wall stands is then not darkened by what it sees inside the box.
//!
//! Values (a texel's side) that exchange light are joined into sets by union and find, in one sweep
//! over the lines; cut texels, which see two spaces, join nothing. A set is sealed when no emitter lights it
//! and backs are at one end at least of each of its pairs, as inside solids. A cut texel is sealed when
//! it sees sealed sets only.

use super::exchange;
use super::layers::Layers;
use super::marks::Marks;
use super::step::Shared;
use crate::ids::{DirectionId, SurfaceId};
use crate::psf::Psf;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Marks the texture values that no light can come to, as far as some lines tell. Works on all threads of
/// the pool that it is called in. `looked` is called after each look along a line; where it says no, the
/// rest is left out.
pub fn marks(shared: &Shared, lines: &[DirectionId], looked: impl Fn() -> bool + Sync) -> Marks {
    let values = 2 * shared.texels.len();
    let cut = &shared.texels.met();
    let look = |reach: &mut Reach, id, layers: &mut _| reach.sweep(shared, cut, id, layers);
    let found = sweep(lines, &looked, || Reach::new(values), look);
    let mut reach = Reach::new(values);
    found.into_iter().for_each(|one| reach.merge(one));
    reach.marks(shared, cut)
}

/// Lets every thread of the pool look along lines until none is left. Returns what each of them found.
fn sweep<T: Send>(
    lines: &[DirectionId],
    looked: &(impl Fn() -> bool + Sync),
    new: impl Fn() -> T + Sync,
    look: impl Fn(&mut T, DirectionId, &mut Layers) + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    rayon::broadcast(|_| {
        let (mut own, mut layers) = (new(), Layers::default());
        while let Some(line) = lines.get(next.fetch_add(1, Ordering::Relaxed)) {
            look(&mut own, *line, &mut layers);
            if !looked() {
                break;
            }
        }
        own
    })
}

/// Sets that a cut value may see before it is asked which of them are one.
const LEAST_ROOM: usize = 4;

/// The place of the view of a value that is not cut, or sees nothing.
const NO_VIEW: u32 = u32::MAX;

/// Sets of values that exchange light.
#[derive(Clone, Debug)]
struct Reach {
    parent: Vec<u32>,
    /// Values that were joined front to front.
    open: Vec<bool>,
    /// What each sees of the other kind: backs of fronts, fronts of backs.
    seen: Vec<Seen>,
    /// For each cut value that sees any, one value at least of each set that it sees.
    views: Vec<View>,
    /// For each value its place in these, or [`NO_VIEW`].
    view_of: Vec<u32>,
}

/// Sets that a cut value sees, by a member of each. Sets are joined while more are found: where there are
/// as many as `room`, those that are one by now are told once.
#[derive(Clone, Debug, Default)]
struct View {
    viewer: u32,
    members: Vec<u32>,
    room: usize,
}

/// What a value sees of the other kind. A closed solid's inside sees no front; but where facets meet in
/// an edge, rounding lets a line through now and then, and one such line must not light the inside.
#[derive(Clone, Copy, Debug)]
struct Seen {
    lines: u32,
    others: u32,
    /// The first one of the other kind that it sees.
    other: u32,
}

impl Seen {
    const NOTHING: Seen = Seen { lines: 0, others: 0, other: u32::MAX };

    fn add(&mut self, other: Seen) {
        self.lines = self.lines.saturating_add(other.lines);
        self.others = self.others.saturating_add(other.others);
        self.other = self.other.min(other.other);
    }

    /// Whether the other kind is more of what it sees than rounding makes it: a hundredth.
    fn is_open(self) -> bool {
        u64::from(self.others) * 100 >= u64::from(self.lines) && self.others > 0
    }
}

/// Calls `visit` with the texture values that look at each other along the lines of a direction.
fn pairs(
    shared: &Shared,
    id: DirectionId,
    layers: &mut Layers,
    mut visit: impl FnMut(usize, usize),
) {
    let resolution = shared.parameters.resolution;
    let psf = Psf::new(shared.directions.vector(id), resolution);
    layers.rasterise(shared.outlines, &psf);
    let (contacts, surface_of) = (&shared.outlines.contacts, &shared.texels.surface_of);
    for j in 0..resolution {
        for i in 0..resolution {
            let fragments = layers.cell(i, j);
            exchange::order_contacts(fragments, contacts, surface_of);
            for pair in fragments.windows(2) {
                if exchange::see_each_other(pair[0], pair[1]) {
                    visit(pair[0].value_along(), pair[1].value_against());
                }
            }
        }
    }
}

impl Reach {
    /// Every value by itself.
    fn new(values: usize) -> Reach {
        Reach {
            parent: (0..values as u32).collect(),
            open: vec![false; values],
            seen: vec![Seen::NOTHING; values],
            views: Vec::new(),
            view_of: vec![NO_VIEW; values],
        }
    }

    fn root(&mut self, mut value: u32) -> u32 {
        while self.parent[value as usize] != value {
            let above = self.parent[self.parent[value as usize] as usize];
            self.parent[value as usize] = above;
            value = above;
        }
        value
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Notes that a cut value sees the set of another.
    fn view(&mut self, viewer: u32, seen: u32) {
        let seen = self.root(seen);
        if self.view_of[viewer as usize] == NO_VIEW {
            self.view_of[viewer as usize] = self.views.len() as u32;
            self.views.push(View { viewer, ..View::default() });
        }
        let place = self.view_of[viewer as usize] as usize;
        let view = &mut self.views[place];
        if view.members.contains(&seen) {
            return;
        }
        view.members.push(seen);
        if view.members.len() > view.room {
            let mut members = std::mem::take(&mut view.members);
            members.iter_mut().for_each(|member| *member = self.root(*member));
            members.sort_unstable();
            members.dedup();
            let room = (2 * members.len()).max(LEAST_ROOM);
            self.views[place] = View { viewer, members, room };
        }
    }

    /// Joins what another sweep joined.
    fn merge(&mut self, other: Reach) {
        for (value, parent) in other.parent.iter().enumerate() {
            self.join(value as u32, *parent);
            self.open[value] |= other.open[value];
            self.seen[value].add(other.seen[value]);
        }
        for View { viewer, members, .. } in other.views {
            members.into_iter().for_each(|member| self.view(viewer, member));
        }
    }

    /// Joins the values that look at each other along the lines of a direction.
    fn sweep(&mut self, shared: &Shared, cut: &[bool], id: DirectionId, layers: &mut Layers) {
        pairs(shared, id, layers, |a, b| {
            match (cut[a / 2], cut[b / 2]) {
                (false, false) => {}
                (true, true) => return,
                (true, false) => return self.view(a as u32, b as u32),
                (false, true) => return self.view(b as u32, a as u32),
            }
            // Even values are fronts.
            let is_front = |value: usize| value.is_multiple_of(2);
            for (value, other) in [(a, b), (b, a)] {
                let (others, other) = match is_front(value) == is_front(other) {
                    true => (0, u32::MAX),
                    false => (1, other as u32),
                };
                self.seen[value].add(Seen { lines: 1, others, other });
            }
            if is_front(a) == is_front(b) {
                self.join(a as u32, b as u32);
                self.open[a] |= is_front(a);
            }
        });
    }

    /// The values that no light can come to.
    fn marks(mut self, shared: &Shared, cut: &[bool]) -> Marks {
        let values = self.parent.len();
        // Of a back and a front that see each other, the back says whether that counts.
        for value in 0..values {
            let other = self.seen[value].other;
            let back = if value.is_multiple_of(2) { other } else { value as u32 };
            if other != u32::MAX && self.seen[back as usize].is_open() {
                self.join(value as u32, other);
            }
        }
        let roots: Vec<usize> = (0..values as u32).map(|v| self.root(v) as usize).collect();
        let surface_of = |value: usize| shared.texels.surface_of[value / 2] as usize;
        let mut lit = vec![false; values];
        let mut alone = vec![true; values];
        for (value, root) in roots.iter().enumerate() {
            lit[*root] |= self.open[value];
            alone[*root] &= *root == value;
        }
        // A lamp lights the set it is in; but a lamp that also shines into the open shines there, and
        // the part of it that a solid stands on is not meant to light the solid's inside.
        let mut shines = vec![false; shared.scene.surfaces.len()];
        for value in (0..values).step_by(2) {
            shines[surface_of(value)] |= lit[roots[value]];
        }
        for value in (0..values).step_by(2) {
            let surface = surface_of(value);
            let material = shared.scene.material_of(SurfaceId(surface as u32));
            lit[roots[value]] |= !material.emitted.is_black() && !shines[surface];
        }
        let mut marks = Marks::new(shared.texels);
        for (value, root) in roots.iter().enumerate() {
            // A front that nothing was joined to has only been missed.
            let missed = alone[*root] && value % 2 == 0;
            if !lit[*root] && !missed && !cut[value / 2] {
                marks.seal(value);
            }
        }
        let is_sealed = |member: &u32| marks.is_sealed(*member as usize);
        let shut = self.views.iter().filter(|view| view.members.iter().all(is_sealed));
        let shut: Vec<u32> = shut.map(|view| view.viewer).collect();
        shut.into_iter().for_each(|viewer| marks.seal(viewer as usize));
        marks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::layers::Outlines;
    use crate::bake::transfer::Quantum;
    use crate::directions::Directions;
    use crate::format::manifest::Parameters;
    use crate::scene::Scene;
    use crate::scene::texels::Texels;
    use std::path::Path;

    /// A sphere of many facets: of the lines that graze it some slip in between two of them.
    #[test]
    fn the_inside_of_a_closed_sphere_is_sealed_and_its_outside_is_not() {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let (scene, _) = Scene::open(&scenes.join("metal_sphere/metal_sphere.obj")).unwrap();
        let parameters = Parameters { directions: 513, ..Parameters::default() };
        let texels = Texels::new(&scene, 2.0 / parameters.resolution as f32);
        let shared = Shared {
            scene: &scene,
            texels: &texels,
            outlines: &Outlines::new(&scene, &texels),
            directions: &Directions::with_lines(parameters.directions).unwrap(),
            parameters: &parameters,
            quantum: Quantum::new(1.0),
            exponent: 0,
        };
        let lines: Vec<DirectionId> = shared.directions.ids().collect();
        let marks = marks(&shared, &lines, || true);
        let mirrors: Vec<usize> = (texels.diffuse as usize..texels.len()).collect();
        assert!(mirrors.len() > 500);
        assert!(mirrors.iter().all(|m| marks.is_sealed(2 * m + 1)), "the inside is open");
        assert!(mirrors.iter().all(|m| !marks.is_sealed(2 * m)), "the outside is sealed");
    }
}
