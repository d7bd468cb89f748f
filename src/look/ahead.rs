//! Maps fetched before a picture asks for them, by several threads at once.
//!
//! In: an opened field and a camera. Out: the maps that a picture of it needs, but for a few, are held as far as they
//! have room. A picture asks for one map after the other, on as many threads as compute; a disk, and a system that
//! copies files, are at their best with more.

use super::lightfield::LightField;
use super::maps::Source;
use crate::gather::{mirrored, shows};
use crate::ids::Side;
use crate::scene::camera::{Camera, View};
use crate::visible::Visible;
use glam::Vec3;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Threads that fetch.
const FETCHERS: usize = 8;

/// Pixels between those that are asked what they need.
const SPACING: usize = 8;

impl LightField {
    /// Fetches the maps that a picture by the first method needs. Those that are damaged are found out by whoever looks
    /// at them.
    pub fn fetch(&self, visible: &Visible, camera: &Camera) {
        let mut needed: Vec<u32> = self.needed(visible, camera).into_iter().collect();
        if let Source::Pack { places, .. } = &self.source {
            needed.sort_by_key(|direction| places[*direction as usize]);
        }
        let next = AtomicUsize::new(0);
        let fetch = || {
            while let Some(direction) = needed.get(next.fetch_add(1, Ordering::Relaxed)) {
                if !self.has_room() || self.held(*direction).is_err() {
                    return;
                }
            }
        };
        thread::scope(|scope| (0..FETCHERS).for_each(|_| _ = scope.spawn(fetch)));
    }

    /// The directions that some of a picture's pixels need.
    fn needed(&self, visible: &Visible, camera: &Camera) -> BTreeSet<u32> {
        let view = camera.view(&self.scene.fit);
        let mut needed = BTreeSet::new();
        for y in (0..camera.height).step_by(SPACING) {
            for x in (0..camera.width).step_by(SPACING) {
                self.add_needed(visible, &view, [x, y].map(|at| f64::from(at) + 0.5), &mut needed);
            }
        }
        needed
    }

    fn add_needed(
        &self,
        visible: &Visible,
        view: &View,
        [x, y]: [f64; 2],
        needed: &mut BTreeSet<u32>,
    ) {
        let (origin, dir) = view.ray(x, y);
        let Some(hit) = visible.nearest(origin, dir, 0.0) else { return };
        let is_mirror = self.scene.material_of(hit.surface).reflectance.is_mirror();
        if self.diffuse_left_out && !is_mirror {
            return;
        }
        let away: Vec3 = -dir;
        let plane = self.scene.surface(hit.surface);
        let normal = plane.normal * Side::facing(plane.normal.dot(away)).sign();
        let wanted = if is_mirror { mirrored(away, normal) } else { away };
        let corners = self.directions.corners(self.directions.around(wanted).0);
        let shown = corners.iter().filter(|near| shows(&self.directions, near, normal));
        needed.extend(shown.map(|near| near.direction.0));
    }
}
