//! The walkthrough itself: keys and mouse in, pictures to take out, what is to be told as text. The
//! window, the browser's server and the tests drive this same machine; it knows no clock, no screen and
//! no thread.

use crate::action::{self, Action, Meaning, meaning};
use crate::collide::slide;
use crate::energy;
use crate::pace::Pace;
use crate::paint::{Frame, Job, Look, Method, Shot};
use crate::source::{News, Source};
use crate::views::Views;
use crate::walk::{LONGEST_STEP, Pressed, Walk};
use bytesize::ByteSize;
use vlf::Camera;
use vlf::look::path::TimedView;
use vlf::look::tone::Curve;

/// Seconds between the views that are recorded of a walk.
const RECORDED: f64 = 0.1;

/// What the walkthrough asks of whoever shows it.
#[derive(Clone, Debug, PartialEq)]
pub enum Wish {
    /// Let the mouse go, else end.
    Leave,
    /// Write the picture to disk, when it is as fine as it gets.
    Screenshot,
    /// Hand a camera, as JSON, to the user.
    Copy(String),
    /// Let the mouse look around, or no longer.
    Capture,
    /// Take all of the screen, or no longer.
    FullScreen,
    /// Open what is newer on disk.
    TakeNext,
}

/// A walk through a light field.
pub struct Walkthrough {
    walk: Walk,
    start: Camera,
    pressed: Pressed,
    /// The view has changed since the last job other than by walking.
    turned: bool,
    collides: bool,
    method: Method,
    look: Look,
    /// The exposure is what a picture asked for, not the user.
    automatic: bool,
    /// What is shown is of a bake under way.
    unfinished: bool,
    /// The look has changed since the last job.
    relook: bool,
    pace: Pace,
    /// Whether the last job was one of a walker at rest.
    refines: bool,
    size: (u32, u32),
    shown: Option<Frame>,
    views: Views,
    overlay: bool,
    help: bool,
    said: String,
    recorded: Vec<TimedView>,
    seconds: f64,
}

impl Walkthrough {
    /// Begins a walk.
    pub fn new(start: Camera, speed: f64, method: Method, exposure: Option<f32>) -> Walkthrough {
        Walkthrough {
            walk: Walk::new(&start, speed),
            start,
            pressed: Pressed::default(),
            turned: true,
            collides: false,
            method,
            look: Look { exposure, curve: Curve::default() },
            automatic: exposure.is_none(),
            unfinished: false,
            relook: false,
            pace: Pace::new(),
            refines: false,
            size: (start.width, start.height),
            shown: None,
            views: Views::default(),
            overlay: false,
            help: false,
            said: String::new(),
            recorded: Vec::new(),
            seconds: 0.0,
        }
    }

    /// The same with saved views at hand.
    pub fn with_views(mut self, views: Views) -> Walkthrough {
        self.said = views.trouble().unwrap_or("").to_owned();
        self.views = views;
        self
    }

    /// A key goes down or up. `code` is its place, `text` what it writes; `saves` says whether Ctrl or
    /// Shift is down.
    pub fn key(&mut self, code: &str, text: &str, down: bool, saves: bool) -> Option<Wish> {
        let once = |action| down.then_some(action);
        let action = match (meaning(code, saves), action::meaning_of_text(text)) {
            (Some(Meaning::Held(way)), _) => {
                self.pressed.set(way, down);
                None
            }
            (_, Some(action)) | (Some(Meaning::Once(action)), None) => once(action),
            (None, None) => None,
        };
        self.act(action?)
    }

    fn act(&mut self, action: Action) -> Option<Wish> {
        self.said.clear();
        match action {
            Action::Brighter => self.expose(0.5),
            Action::Darker => self.expose(-0.5),
            Action::AutoExposure => {
                self.look.exposure = None;
                (self.automatic, self.relook) = (true, true);
            }
            Action::NextCurve => {
                self.look.curve = match self.look.curve {
                    Curve::Shoulder => Curve::Reinhard,
                    Curve::Reinhard => Curve::Plain,
                    Curve::Plain => Curve::Shoulder,
                };
                self.relook = true;
                self.said = format!("tone curve: {}", curve_name(self.look.curve));
            }
            Action::NextMethod => {
                self.method = match self.method {
                    Method::Field => Method::Trace,
                    Method::Trace => Method::Difference,
                    Method::Difference => Method::Field,
                };
                self.pace.another_method();
                self.turned = true;
                self.said = format!("method: {}", self.method.name());
            }
            Action::Collide => {
                self.collides = !self.collides;
                let what = if self.collides { "stop" } else { "do not stop" };
                self.said = format!("walls {what} the walker");
            }
            Action::Overlay => self.overlay = !self.overlay,
            Action::Help => self.help = !self.help,
            Action::Reset => self.go_to(self.start),
            Action::Recall(digit) => match self.views.get(digit).copied() {
                Some(camera) => self.go_to(camera),
                None => self.said = format!("no view is saved on {digit}"),
            },
            Action::Save(digit) => {
                let camera = self.camera();
                self.said = match self.views.save(digit, camera) {
                    Ok(place) => format!("view {digit} saved in {}", place.display()),
                    Err(e) => format!("view {digit} is not saved: {e}"),
                };
            }
            Action::TakeNext => return Some(Wish::TakeNext),
            Action::Screenshot => return Some(Wish::Screenshot),
            Action::CopyCamera => {
                let camera = serde_json::to_string(&self.camera()).unwrap_or_default();
                return Some(Wish::Copy(camera));
            }
            Action::Capture => return Some(Wish::Capture),
            Action::FullScreen => return Some(Wish::FullScreen),
            Action::Leave if self.help => self.help = false,
            Action::Leave => return Some(Wish::Leave),
        }
        None
    }

    /// The scene is dragged by the pointer, in pixels.
    pub fn drag(&mut self, right: f64, down: f64) {
        self.walk.turn(right, down);
        self.turned = true;
    }

    /// The captured mouse looks around, in pixels.
    pub fn look_around(&mut self, right: f64, down: f64) {
        self.drag(-right, -down);
    }

    /// The wheel turns by notches.
    pub fn wheel(&mut self, notches: f64) {
        self.walk.faster(notches);
        self.said = format!("speed {:.3} a second", self.walk.speed());
    }

    /// No key is held any more, as when another window has the keyboard.
    pub fn let_go(&mut self) {
        self.pressed = Pressed::default();
    }

    /// Goes to where a camera stands.
    pub fn go_to(&mut self, camera: Camera) {
        self.walk.go_to(&camera);
        self.turned = true;
    }

    /// Something to be told until the next key.
    pub fn say(&mut self, what: String) {
        self.said = what;
    }

    /// The field has changed: what is shown is of the one before.
    pub fn another_source(&mut self) {
        self.turned = true;
        self.pace.another_method();
        // A field of which more is baked is brighter.
        if self.automatic && self.unfinished {
            self.look.exposure = None;
        }
    }

    /// No frame of a moving walker is finer than that.
    pub fn no_finer(&mut self, coarse: u32) {
        self.pace.no_finer(coarse);
    }

    /// What the walker sees, in the size in which it is shown.
    pub fn camera(&self) -> Camera {
        self.walk.camera(self.size.0, self.size.1)
    }

    /// The picture that was shown last.
    pub fn shown(&self) -> Option<&Frame> {
        self.shown.as_ref()
    }

    /// Whether the picture shown is of the view as it is, and as fine as it gets.
    pub fn is_done(&self) -> bool {
        let stands = !self.turned && !self.relook && !self.is_walking();
        stands && self.shown.as_ref().is_some_and(|f| f.taken.shot.pass.is_last())
    }

    /// Whether the picture that is being taken is worth less than the next. A moving frame is shown
    /// however late; else none would be while the walker moves.
    pub fn is_overtaken(&self) -> bool {
        self.refines && (self.turned || self.is_walking())
    }

    fn is_walking(&self) -> bool {
        self.pressed != Pressed { hurry: self.pressed.hurry, ..Pressed::default() }
    }

    /// What to do next, `seconds` after the last time this was asked, for a picture of `size` pixels.
    /// `None`: what is shown is as good as it gets.
    pub fn next(&mut self, source: &Source, seconds: f64, size: (u32, u32)) -> Option<Job> {
        let Source { field, visible, .. } = source;
        self.unfinished = !field.is_finished();
        let collides = self.collides;
        let stepped = self.walk.step(self.pressed, seconds, &|from, way| match collides {
            true => slide(&field.scene, visible, from, way),
            false => way,
        });
        let moves = stepped || self.turned || size != self.size;
        (self.size, self.turned) = (size, false);
        if moves {
            self.pace.changed();
            self.record(seconds);
        } else if self.relook
            && let Some(frame) = &self.shown
        {
            (self.relook, self.refines) = (false, false);
            return Some(Job::Develop(frame.taken.clone(), self.look));
        }
        let pass = self.pace.next(moves)?;
        (self.relook, self.refines) = (false, !moves);
        // The first picture needs no maps, so that there is something to see at once.
        let at_once = self.shown.is_none() || self.unfinished;
        let method = if at_once { Method::Trace } else { self.method };
        Some(Job::Take(Shot { camera: self.camera(), pass, method }, self.look))
    }

    /// A job is done and its picture shown.
    pub fn took(&mut self, job: &Job, frame: Frame) {
        if let Job::Take(shot, look) = job {
            if self.shown.is_some() || self.method == Method::Trace {
                self.pace.took(shot.pass, frame.time);
            }
            // The look that was asked for meanwhile is another.
            self.relook |= *look != self.look;
        }
        if self.look.exposure.is_none() {
            self.look.exposure = frame.look.exposure;
            self.relook = false;
        }
        self.shown = Some(frame);
    }

    /// The walk so far, for `vlf-view --bench` and `vlf render --path`.
    pub fn recorded(&self) -> &[TimedView] {
        &self.recorded
    }

    fn record(&mut self, seconds: f64) {
        self.seconds += seconds.clamp(0.0, LONGEST_STEP);
        let due = self.recorded.last().is_none_or(|last| self.seconds >= last.time + RECORDED);
        if due {
            let Camera { eye, target, up, vfov_deg, .. } = self.camera();
            self.recorded.push(TimedView { time: self.seconds, eye, target, up, vfov_deg });
        }
    }

    fn expose(&mut self, stops: f32) {
        if let Some(ev) = &mut self.look.exposure {
            *ev = (*ev + stops).clamp(-100.0, 100.0);
            self.said = format!("exposure {ev:+.1} stops");
            (self.automatic, self.relook) = (false, true);
        }
    }

    /// What is to be read in the picture, line by line.
    pub fn lines(&self, source: &Source, news: &News) -> Vec<String> {
        let mut lines: Vec<String> =
            [&news.trouble, &news.offer].into_iter().flatten().cloned().collect();
        let field = &source.field;
        if !field.is_finished() {
            let (cycles, method) = (field.manifest.cycle, self.method);
            let other = method != Method::Trace;
            let why = if other { "; method field must wait for the rest" } else { "" };
            lines.push(format!("not finished: the light of {cycles} cycles{why}"));
        }
        if let Some(damaged) = self.shown.as_ref().map(|f| f.taken.damaged).filter(|n| *n > 0) {
            lines.push(format!("{damaged} damaged maps: what needs them is magenta"));
        }
        if !self.said.is_empty() {
            lines.push(self.said.clone());
        }
        if self.overlay {
            lines.extend(self.figures(source));
        }
        if self.help {
            lines.extend(action::help().lines().map(str::to_owned));
        }
        lines
    }

    fn figures(&self, source: &Source) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(Frame { taken, look, time, .. }) = &self.shown {
            let by = taken.shot.taken_by();
            let Camera { width, height, .. } = taken.shot.camera;
            lines.push(format!(
                "{:.1} ms  {} x {} of {width} x {height}, {} a pixel",
                time.as_secs_f64() * 1e3,
                by.width,
                by.height,
                taken.shot.pass.samples
            ));
            let ev = look.exposure.unwrap_or(0.0);
            lines.push(format!(
                "{}  exposure {ev:+.1}  curve {}  walls {}",
                taken.shot.method.name(),
                curve_name(look.curve),
                if self.collides { "on" } else { "off" }
            ));
        }
        let eye = self.camera().eye;
        let speed = self.walk.speed();
        lines.push(format!("at {:.3} {:.3} {:.3}  speed {speed:.3}", eye.x, eye.y, eye.z));
        let [held, most] =
            [source.field.memory(), source.memory].map(|b| ByteSize::b(b).display().iec());
        lines.push(format!("cache {held} of {most}"));
        lines.extend(energy::lines(&source.field.manifest.ledger));
        lines
    }
}

fn curve_name(curve: Curve) -> &'static str {
    match curve {
        Curve::Shoulder => "shoulder",
        Curve::Reinhard => "Reinhard",
        Curve::Plain => "plain",
    }
}

#[cfg(test)]
mod tests;
