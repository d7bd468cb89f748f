//! What is looked at: a baked light field, opened, and what is newer of it on disk.

use crate::collide::is_open;
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;
use vlf::Visible;
use vlf::format::limits::Limits;
use vlf::format::manifest::{Manifest, Phase};
use vlf::look::lightfield::{LookError, newest_manifest};
use vlf::look::packed::Access;
use vlf::{Camera, LightField};

/// What to open, and how.
#[derive(Clone, Debug)]
pub struct Opening {
    /// The packed light field, or the field itself, which may still be baked.
    pub path: PathBuf,
    /// How a pack is looked into.
    pub access: Access,
    /// Bytes that decoded maps may take.
    pub memory: u64,
    /// Limits on what a file may state.
    pub limits: Limits,
}

/// An opened light field.
pub struct Source {
    /// The field.
    pub field: LightField,
    /// What a ray meets first in its scene.
    pub visible: Visible,
    /// Where to start.
    pub start: Camera,
    /// A walking speed that suits the scene's size, in its own units a second.
    pub speed: f64,
    /// Bytes that decoded maps may take.
    pub memory: u64,
    /// Whether a picture has been taken that needs maps.
    pub begun: AtomicBool,
}

impl Opening {
    /// Opens it at its newest whole generation.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(&self) -> Result<Source, LookError> {
        let field = LightField::open_newest(&self.path, self.access, &self.limits)?;
        let field = field.with_memory(self.memory);
        let visible = Visible::new(&field.scene);
        let start = first_view(&field, &visible);
        let speed = 0.4 * field.scene.fit.radius;
        let begun = AtomicBool::new(false);
        Ok(Source { field, visible, start, speed, memory: self.memory, begun })
    }
}

/// What there is on disk that is not what is shown.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct News {
    /// What is wrong with what is shown.
    pub trouble: Option<String>,
    /// What can be taken instead.
    pub offer: Option<String>,
}

/// What is shown, and what is newer.
pub struct Feed {
    opening: Opening,
    state: Mutex<State>,
}

struct State {
    now: Arc<Source>,
    mark: Option<Mark>,
    news: News,
}

/// By what a file is known again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Mark {
    inode: u64,
    length: u64,
    modified: Option<SystemTime>,
}

impl Feed {
    /// Opens what is to be looked at.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(opening: Opening) -> Result<Feed, LookError> {
        // Before it is opened: what changes meanwhile is news.
        let mark = Mark::of(&opening.path);
        let now = Arc::new(opening.open()?);
        let state = Mutex::new(State { now, mark, news: News::default() });
        Ok(Feed { opening, state })
    }

    /// What is shown.
    pub fn now(&self) -> Arc<Source> {
        self.state().now.clone()
    }

    /// What is newer, as of the last [`Feed::check`].
    pub fn news(&self) -> News {
        self.state().news.clone()
    }

    /// Looks at the disk. Returns whether there is something new to say.
    pub fn check(&self) -> bool {
        let (shown, mark) = {
            let state = self.state();
            (state.now.clone(), state.mark)
        };
        let news = match self.opening.path.is_dir() {
            true => self.news_of_field(&shown.field.manifest),
            false => news_of_pack(mark, Mark::of(&self.opening.path)),
        };
        let mut state = self.state();
        // What was opened meanwhile has its own news.
        let is_new = Arc::ptr_eq(&state.now, &shown) && state.news != news;
        if is_new {
            state.news = news;
        }
        is_new
    }

    /// Opens what is on disk now.
    ///
    /// # Errors
    /// When it cannot be read; what was shown stays.
    pub fn take_next(&self) -> Result<(), LookError> {
        let mark = Mark::of(&self.opening.path);
        let now = Arc::new(self.opening.open()?);
        *self.state() = State { now, mark, news: News::default() };
        Ok(())
    }

    fn news_of_field(&self, shown: &Manifest) -> News {
        let newest = match newest_manifest(&self.opening.path, &self.opening.limits) {
            Ok((_, newest)) => newest,
            Err(e) => return News { trouble: Some(e.to_string()), offer: None },
        };
        let stage = |m: &Manifest| (m.phase == Phase::Finished, m.cycle, m.parameters.directions);
        let is_other = newest.scene_hash != shown.scene_hash || newest.digest != shown.digest;
        if stage(&newest) == stage(shown) && !is_other {
            return News::default();
        }
        let what = match newest.phase {
            Phase::Finished => "the bake is finished".to_owned(),
            _ => format!("the light of {} cycles is there", newest.cycle),
        };
        News { trouble: None, offer: Some(format!("{what}: N takes it")) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn news_of_pack(opened: Option<Mark>, now: Option<Mark>) -> News {
    let trouble = match (opened, now) {
        (a, b) if a == b => return News::default(),
        (_, None) => "the pack is gone from its place",
        (Some(a), Some(b)) if a.inode == b.inode && b.length < a.length => "the pack was cut short",
        _ => "the pack was replaced",
    };
    let offer = now.map(|_| "N opens the pack as it is now".to_owned());
    News { trouble: Some(trouble.to_owned()), offer }
}

impl Mark {
    fn of(path: &Path) -> Option<Mark> {
        let data = std::fs::metadata(path).ok()?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&data);
        #[cfg(not(unix))]
        let inode = 0;
        Some(Mark { inode, length: data.len(), modified: data.modified().ok() })
    }
}

/// A place inside the scene and a level view from it that shows most of it: of a grid of places and
/// sixteen headings, where the nearer half of the surfaces in view is farthest away.
fn first_view(field: &LightField, visible: &Visible) -> Camera {
    let mut best = (0.0, Vec3::ZERO, Vec3::NEG_Z);
    for place in 0..7 * 5 * 7 {
        let at = |n: i32, of: i32| (n as f32 + 0.5) / of as f32 * 2.0 - 1.0;
        let eye = Vec3::new(at(place % 7, 7), at(place / 7 % 5, 5), at(place / 35, 7)) * 0.7;
        if !is_open(visible, eye) {
            continue;
        }
        for heading in 0..16 {
            let (sin, cos) = (heading as f32 / 8.0 * std::f32::consts::PI).sin_cos();
            let (ahead, right) = (Vec3::new(sin, 0.0, -cos), Vec3::new(cos, 0.0, sin));
            let mut seen: Vec<f32> = (0..25)
                .map(|k| {
                    let (x, y) = ((k % 5 - 2) as f32 * 0.3, (k / 5 - 2) as f32 * 0.22);
                    let dir = (ahead + right * x + Vec3::Y * y).normalize();
                    // Looking past the scene is worth less than looking at a wall.
                    visible.nearest(eye, dir, 0.0).map_or(0.0, |hit| hit.distance)
                })
                .collect();
            seen.sort_by(f32::total_cmp);
            let score: f32 = seen[..13].iter().sum();
            if score > best.0 {
                best = (score, eye, ahead);
            }
        }
    }
    let fit = &field.scene.fit;
    let eye = fit.to_own(best.1);
    Camera {
        eye,
        target: eye + best.2.as_dvec3() * fit.radius,
        up: DVec3::Y,
        vfov_deg: 60.0,
        width: 640,
        height: 480,
    }
}

#[cfg(test)]
mod tests;
