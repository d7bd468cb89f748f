//! Mirrors in a step (section 4.3): what they send along a PSF's lines, and what arrives at them.
//!
//! What a mirror sends is found at the end of its path, or between the maps of what has arrived at it.

use super::{FAR, Few, Flow, Line, Scratch, Shared, is_open};
use crate::bake::layers::Fragment;
use crate::bake::ledger::channels;
use crate::bake::links::{Links, Seen, Shown};
use crate::bake::transfer::clip;
use crate::bake::transfer::specular::MirrorSender;
use crate::bake::transfer::{Fixed, add};
use crate::format::manifest::Parameters;
use crate::format::tiles::{CoveredCell, Layout, TileMap};
use crate::ids::{Cell, Sense, Side, SurfaceId};
use crate::paths::Paths;
use crate::radiance::Rgb;
use crate::scene::texels::Texels;
use crate::visible::Hit;
use glam::Vec3;

/// What travels along a line from a fragment.
struct Sent {
    line: Fixed,
    /// The value that it is from: the fragment's own, or that at the end of the path that it shows.
    from: u32,
    /// What mirrors carry of it; `None` where none is on the way.
    carried: Option<Rgb>,
}

impl Links {
    /// Notes what was sent to a value along the line of a cell.
    fn note(&mut self, cell: Cell, &Sent { from, carried, .. }: &Sent, to: u32) {
        let cell = cell.into();
        match carried {
            Some(carried) => self.shown.push(Shown { from, carried, to, cell }),
            None => self.seen.push(Seen { from, mirror: to, cell }),
        }
    }
}

impl Line<'_> {
    /// The pairs of a line of which at least one is a mirror.
    pub(super) fn exchange_with_mirrors<const SHARES: i64, const COUNTS: i64>(
        &self,
        cell: Cell,
        scratch: &mut Scratch,
    ) {
        let (count, marks) = (scratch.line.len(), self.cycle.marks);
        let is_mirror = |f: Fragment| f.texel() >= self.shared.texels.diffuse;
        for gap in 0..=count {
            let near = gap.checked_sub(1).map(|k| (k, scratch.line[k]));
            let far = (gap < count).then(|| (gap, scratch.line[gap]));
            let open = match (near, far) {
                (Some((_, near)), Some((_, far))) => {
                    (is_mirror(near) || is_mirror(far)) && is_open(near, far, marks)
                }
                (Some((_, near)), None) => is_mirror(near) && !marks.is_sealed(near.value_along()),
                (None, Some((_, far))) => is_mirror(far) && !marks.is_sealed(far.value_against()),
                (None, None) => false,
            };
            if !open {
                continue;
            }
            let gap = match (near, far) {
                (Some((_, near)), Some((_, far))) => far.depth() - near.depth(),
                _ => FAR,
            };
            let along = self.sent::<SHARES, COUNTS>((cell, gap), near, Sense::Along, scratch);
            let against = self.sent::<SHARES, COUNTS>((cell, gap), far, Sense::Against, scratch);
            // What goes along arrives at the far one's side that faces against the direction.
            self.received::<SHARES, COUNTS>((cell, far), &along, Sense::Against, scratch);
            self.received::<SHARES, COUNTS>((cell, near), &against, Sense::Along, scratch);
        }
    }

    /// What a fragment sends over a gap, or what comes from outside the scene.
    fn sent<const SHARES: i64, const COUNTS: i64>(
        &self,
        (cell, gap): (Cell, f32),
        sender: Option<(usize, Fragment)>,
        sense: Sense,
        scratch: &mut Scratch,
    ) -> Sent {
        let outside = self.cycle.outside() as u32;
        let straight = |line, from| Sent { line, from, carried: None };
        let Some((_, fragment)) = sender else {
            return straight(self.cycle.current.line(outside as usize), outside);
        };
        if fragment.texel() < self.shared.texels.diffuse {
            let (value, current) = (fragment.value(sense), self.cycle.current);
            let line = if self.clips() {
                let ground = self.ground(&scratch.projections);
                clip::mean(scratch.clip.taps(cell, value as u32, &ground), current)
            } else {
                current.line(value)
            };
            add::<SHARES, COUNTS>(&mut scratch.flow.shot, &line);
            return straight(line, value as u32);
        }
        let sent = match &self.cycle.paths {
            Some(paths) => self.traced(paths, (cell, gap), fragment, sense, scratch),
            None => straight(self.mirror(cell, fragment, sense, scratch), outside),
        };
        add::<SHARES, COUNTS>(&mut scratch.flow.shot_mirror, &sent.line);
        sent
    }

    /// Takes what arrives at a fragment, or leaves the scene.
    fn received<const SHARES: i64, const COUNTS: i64>(
        &self,
        (cell, receiver): (Cell, Option<(usize, Fragment)>),
        sent: &Sent,
        sense: Sense,
        scratch: &mut Scratch,
    ) {
        let line = &sent.line;
        let outside = self.cycle.outside();
        let to = receiver.map_or(outside, |(_, fragment)| fragment.value(sense));
        if let Some(links) = &mut scratch.links {
            links.note(cell, sent, to as u32);
        }
        match receiver {
            Some((_, f)) if f.texel() < self.shared.texels.diffuse && self.clips() => {
                // The other end is a mirror: these are still the taps of this one.
                let taps = scratch.clip.last_taps();
                clip::share_out::<SHARES, COUNTS>(line, taps, &mut scratch.sums[self.half]);
            }
            Some((k, f)) if f.texel() >= self.shared.texels.diffuse => {
                self.arrive::<SHARES, COUNTS>(f.texel(), line, &mut scratch.flow);
                scratch.arrived[k][sense.slot()] = self.shared.quantum.radiance(*line);
            }
            _ => add::<SHARES, COUNTS>(&mut scratch.sums[self.half][to], line),
        }
    }

    /// The same as was found in an earlier cycle, with this one's light.
    pub(super) fn mirrored_again<const SHARES: i64>(&self, links: &Links, scratch: &mut Scratch) {
        let (current, quantum, outside) =
            (self.cycle.current, self.shared.quantum, self.cycle.outside());
        let Scratch { sums, flow, tally, clip, projections, .. } = scratch;
        let (sums, ground) = (&mut sums[self.half], self.ground(projections));
        for Seen { from, mirror, cell } in &links.seen {
            let line = match self.clips() {
                true => clip::mean(clip.taps((*cell).into(), *from, &ground), current),
                false => current.line(*from as usize),
            };
            if *from as usize != outside {
                add::<SHARES, 1>(&mut flow.shot, &line);
            }
            self.arrive::<SHARES, 1>(mirror / 2, &line, flow);
        }
        let mirrors = 2 * self.shared.texels.diffuse as usize..outside;
        for Shown { from, carried, to, cell } in &links.shown {
            let line = quantum.fixed(*carried * current.radiance(*from as usize));
            add::<SHARES, 1>(&mut flow.shot_mirror, &line);
            match (mirrors.contains(&(*to as usize)), self.clips()) {
                (true, _) => self.arrive::<SHARES, 1>(to / 2, &line, flow),
                (false, true) => {
                    let taps = clip.taps((*cell).into(), *to, &ground);
                    clip::share_out::<SHARES, 1>(&line, taps, sums);
                }
                (false, false) => add::<SHARES, 1>(&mut sums[*to as usize], &line),
            }
        }
        tally.gathers += links.shown.len() as u64;
        self.leave(sums, tally);
    }

    /// What a mirror sends from its fragment in a cell, found at the end of its path.
    fn traced(
        &self,
        paths: &Paths,
        (cell, gap): (Cell, f32),
        fragment: Fragment,
        sense: Sense,
        scratch: &mut Scratch,
    ) -> Sent {
        let Shared { scene, texels, quantum, outlines, .. } = *self.shared;
        let outside = self.cycle.outside() as u32;
        let surface = SurfaceId(texels.surface_of[fragment.texel() as usize]);
        let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
        let place = (surface, self.psf.unproject(x, y, fragment.depth()), gap);
        if self.few.is_some_and(|few| !self.may_send(&few, place, sense)) {
            let line = self.cycle.current.line(outside as usize);
            return Sent { line, from: outside, carried: Some(Rgb::BLACK) };
        }
        scratch.tally.gathers += 1;
        scratch.watch.profile.paths += 1;
        let (dir, hit) = self.met(place, sense);
        let path = paths.follow(dir, &hit, self.cycle.number == 0);
        let value = |end: Hit| {
            let texel = texels.at(end.surface, scene.surface(end.surface), end.point);
            2 * outlines.homes.of(scene, texels, texel, end.point) + end.side.index() as u32
        };
        let from = path.end.map_or(outside, value);
        let light = path.carried * self.cycle.current.radiance(from as usize);
        let line = quantum.fixed(path.emitted + light);
        Sent { line, from, carried: Some(path.carried) }
    }

    /// A mirror's point, as it is met by who looks at it from a distance against the way that it sends.
    fn met(&self, (surface, point, distance): (SurfaceId, Vec3, f32), sense: Sense) -> (Vec3, Hit) {
        let outgoing = self.psf.direction * sense.sign();
        let side = Side::facing(self.shared.scene.surface(surface).normal.dot(outgoing));
        (-outgoing, Hit { surface, point, distance, side })
    }

    /// Whether one of few senders may send from a point.
    pub(super) fn may_send(&self, few: &Few, place: (SurfaceId, Vec3, f32), sense: Sense) -> bool {
        let Some(paths) = &few.paths else { return true };
        let (dir, hit) = self.met(place, sense);
        let texel = self.shared.texels.lattices[place.0.index()].first as usize;
        if self.cycle.marks.is_sealed(2 * texel + hit.side.index()) {
            return false;
        }
        let emits = |s: SurfaceId| !self.shared.scene.material_of(s).emitted.is_black();
        paths.may_send(dir, &hit, |hit| hit.side == Side::Front && emits(hit.surface))
    }

    /// What a mirror sends from its fragment in a cell, from what has arrived at it.
    fn mirror(&self, cell: Cell, fragment: Fragment, sense: Sense, scratch: &mut Scratch) -> Fixed {
        let texels = self.shared.texels;
        let slot = 2 * (fragment.texel() - texels.diffuse) as usize + sense.slot();
        if scratch.senders[slot].is_none() {
            let Shared { scene, directions, .. } = *self.shared;
            let surface = SurfaceId(texels.surface_of[fragment.texel() as usize]);
            let what = (surface, self.psf.direction * sense.sign(), self.cycle.number == 0);
            let pages = self.cycle.pages;
            match MirrorSender::new(scene, directions, pages, what, self.psf.resolution) {
                Ok(sender) => scratch.senders[slot] = Some(sender),
                Err(error) => {
                    scratch.failure.get_or_insert(error);
                    return self.shared.quantum.fixed(Rgb::BLACK);
                }
            }
            scratch.used_senders.push(slot);
        }
        scratch.tally.gathers += 1;
        let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
        let sender = scratch.senders[slot].as_ref();
        let point = self.psf.unproject(x, y, fragment.depth());
        let radiance = sender.and_then(|sender| sender.radiance(point));
        scratch.tally.holes += u64::from(radiance.is_none());
        self.shared.quantum.fixed(radiance.unwrap_or_default())
    }

    /// Accounts for light that arrives at a mirror.
    fn arrive<const SHARES: i64, const COUNTS: i64>(
        &self,
        texel: u32,
        line: &Fixed,
        flow: &mut Flow,
    ) {
        let surface = SurfaceId(self.shared.texels.surface_of[texel as usize]);
        let rho = self.shared.scene.material_of(surface).reflectance.factor().0;
        let reflected = |c: usize| (line[c] as f64 * f64::from(rho[c])) as i64;
        add::<SHARES, COUNTS>(&mut flow.to_mirror, line);
        add::<SHARES, COUNTS>(&mut flow.mirrored, &[reflected(0), reflected(1), reflected(2), 0]);
    }

    /// Accounts for the unshot radiance as it was stored.
    pub(super) fn tally_stored<const SHARES: i64, const COUNTS: i64>(
        &self,
        unshot: &[u8],
        scratch: &mut Scratch,
    ) {
        let Parameters { resolution, tile, .. } = *self.shared.parameters;
        let surfaces = self.shared.scene.surfaces.len() as u32;
        let Ok(layout) = Layout::check(unshot, resolution, tile, surfaces, self.shared.exponent)
        else {
            return;
        };
        let map = TileMap::new(unshot, &layout);
        map.for_each(|surface, _, both| {
            let rho = self.shared.scene.material_of(surface).reflectance.factor();
            for radiance in both {
                let line = self.shared.quantum.fixed(radiance * rho);
                scratch.tally.stored += i128::from(channels(&line) * SHARES);
            }
        });
    }
}

/// Keeps what arrived at the mirrors of a cell for the tile's map.
pub(super) fn keep_mirrors(texels: &Texels, scratch: &mut Scratch, cell: Cell, inside: u32) {
    let fragments = scratch.layers.cell(cell.i, cell.j);
    for (k, fragment) in fragments.iter().enumerate() {
        if fragment.texel() >= texels.diffuse {
            let radiance = &scratch.arrived[k];
            let surface = SurfaceId(texels.surface_of[fragment.texel() as usize]);
            scratch.tile.push(CoveredCell { surface, cell: inside, radiance: *radiance });
        }
    }
}
