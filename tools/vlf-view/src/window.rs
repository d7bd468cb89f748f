//! The window: events in, frames out.

use crate::overlay::{enlarge, write};
use crate::pace::Pass;
use crate::paint::{Frame, Job, Shot, Spare, paint};
use crate::shots;
use crate::source::Feed;
use crate::state::{Walkthrough, Wish};
use crate::worker::Worker;
use arboard::Clipboard;
use rayon::ThreadPoolBuilder;
use softbuffer::{Context, SoftBufferError, Surface};
use std::io::Write;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::{Duration, Instant};
use vlf::look::path::TimedView;
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{
    DeviceEvent, DeviceId, ElementState, KeyEvent, MouseButton, MouseScrollDelta, WindowEvent,
};
use winit::event_loop::{
    ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy, OwnedDisplayHandle,
};
use winit::keyboard::{Key, ModifiersState, PhysicalKey};
use winit::window::{CursorGrabMode, Fullscreen, Window, WindowId};

/// How often the disk is asked for something newer.
const ASKED: Duration = Duration::from_millis(500);

/// The seconds that the first step of a walk stands for: a frame's.
const FIRST_STEP: f64 = 1.0 / 60.0;

/// A button that goes up within so many pixels of where it went down has clicked, not dragged.
const CLICK: f64 = 4.0;

/// Why there is no window.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// There is nothing to show windows on.
    #[error("no window can be opened, is there a display? ({0})")]
    NoDisplay(String),
    /// The window stopped working.
    #[error("the window failed: {0}")]
    Failed(String),
}

/// What is shown, and how it starts.
pub struct Show {
    /// Title of the window.
    pub title: String,
    /// Size of the window in pixels.
    pub size: (u32, u32),
    /// The walk.
    pub state: Walkthrough,
    /// What is looked at.
    pub feed: Arc<Feed>,
    /// The folder and the beginning of the names of screenshots.
    pub shots: (PathBuf, String),
}

/// What other threads tell the window.
enum Told {
    /// A job is done, or was overtaken.
    Done(Job, Option<Frame>),
    /// There is something newer on disk, or something wrong.
    News,
    /// What was newer is open, or why it is not.
    Opened(Result<(), String>),
    /// Something to show.
    Say(String),
}

/// Shows the window until it is closed. Returns the walk.
///
/// # Errors
/// When there is no display or the window system fails.
pub fn run(show: Show) -> Result<Vec<TimedView>, WindowError> {
    let events = EventLoop::with_user_event()
        .build()
        .map_err(|e| WindowError::NoDisplay(plain(&e.to_string())))?;
    let context = Context::new(events.owned_display_handle())
        .map_err(|e| WindowError::NoDisplay(e.to_string()))?;
    let proxy = events.create_proxy();
    // Whoever sends after the window is gone tells nobody.
    let teller = proxy.clone();
    let worker = Worker::new(move |job, frame| _ = teller.send_event(Told::Done(job, frame)));
    watch(show.feed.clone(), proxy.clone());
    let mut app = App {
        show,
        context,
        proxy,
        worker,
        surface: None,
        inner: PhysicalSize::default(),
        under_way: false,
        idle: true,
        last: Instant::now(),
        modifiers: ModifiersState::empty(),
        pointer: PhysicalPosition::default(),
        drag: None,
        captured: false,
        clipboard: None,
        failure: None,
    };
    events.run_app(&mut app).map_err(|e| WindowError::Failed(e.to_string()))?;
    app.failure.map_or(Ok(app.show.state.recorded().to_vec()), Err)
}

/// Looks at the disk again and again, until the window is gone.
fn watch(feed: Arc<Feed>, proxy: EventLoopProxy<Told>) {
    thread::spawn(move || {
        loop {
            thread::sleep(ASKED);
            if feed.check() && proxy.send_event(Told::News).is_err() {
                return;
            }
        }
    });
}

/// The window library's message without the place in its source that it begins with.
fn plain(message: &str) -> String {
    let after_line = |rest: &str| rest.split_once(": ").map(|(_, said)| said.to_owned());
    let said = message.rsplit_once(".rs:").and_then(|(_, rest)| after_line(rest));
    said.unwrap_or_else(|| message.to_owned())
}

struct App {
    show: Show,
    context: Context<OwnedDisplayHandle>,
    proxy: EventLoopProxy<Told>,
    worker: Worker,
    surface: Option<Surface<OwnedDisplayHandle, Rc<Window>>>,
    /// The window's size as it was last told; a window that is gone cannot be asked.
    inner: PhysicalSize<u32>,
    /// The worker has a job.
    under_way: bool,
    /// The picture stands.
    idle: bool,
    last: Instant,
    modifiers: ModifiersState,
    pointer: PhysicalPosition<f64>,
    /// How far the pointer went since its button went down.
    drag: Option<f64>,
    captured: bool,
    clipboard: Option<Clipboard>,
    failure: Option<WindowError>,
}

impl App {
    fn fail(&mut self, events: &ActiveEventLoop, failure: WindowError) {
        self.failure = Some(failure);
        events.exit();
    }

    fn window(&self) -> Option<&Window> {
        self.surface.as_ref().map(|surface| surface.window().as_ref())
    }

    fn redraw(&self) {
        if let Some(window) = self.window() {
            window.request_redraw();
        }
    }

    /// The size of the picture; `None` while there is nothing to see of it.
    fn size(&self) -> Option<(u32, u32)> {
        self.window()?;
        let PhysicalSize { width, height } = self.inner;
        // What a camera can take; no screen is larger.
        let within = |n: u32| (1..=16_384).contains(&n);
        (within(width) && within(height)).then_some((width, height))
    }

    /// Gives the worker what there is to do, unless it is busy with something better.
    fn pump(&mut self, events: &ActiveEventLoop) {
        if self.under_way {
            if self.show.state.is_overtaken() {
                self.worker.overtake();
            }
            return;
        }
        let Some(size) = self.size() else { return };
        // A key that went down is walked from now on, not from the last frame.
        let seconds = if self.idle { FIRST_STEP } else { self.last.elapsed().as_secs_f64() };
        self.last = Instant::now();
        let source = self.show.feed.now();
        let job = self.show.state.next(&source, seconds, size);
        self.idle = job.is_none();
        if let Some(job) = job {
            self.under_way = true;
            if !self.worker.begin(source, job) {
                let why = "the thread that takes the pictures has ended".into();
                self.fail(events, WindowError::Failed(why));
            }
        }
    }

    fn key(&mut self, events: &ActiveEventLoop, event: &KeyEvent) {
        let PhysicalKey::Code(code) = event.physical_key else { return };
        let text = match &event.logical_key {
            Key::Character(text) => text.as_str(),
            _ => "",
        };
        let down = event.state == ElementState::Pressed;
        let saves = self.modifiers.control_key() || self.modifiers.shift_key();
        // The window library's names of keys are those of browsers.
        let wish = self.show.state.key(&format!("{code:?}"), text, down, saves);
        if let Some(wish) = wish {
            self.fulfil(events, wish);
        }
        if down {
            self.redraw();
        }
    }

    fn fulfil(&mut self, events: &ActiveEventLoop, wish: Wish) {
        match wish {
            Wish::Leave if self.captured => self.capture(false),
            Wish::Leave => events.exit(),
            Wish::Capture => self.capture(!self.captured),
            Wish::FullScreen => {
                if let Some(window) = self.window() {
                    let all = window.fullscreen().is_none();
                    window.set_fullscreen(all.then_some(Fullscreen::Borderless(None)));
                }
            }
            Wish::Copy(camera) => self.copy(camera),
            Wish::Screenshot => self.screenshot(),
            Wish::TakeNext => {
                self.show.state.say("opening what is on disk".into());
                let (feed, proxy) = (self.show.feed.clone(), self.proxy.clone());
                thread::spawn(move || {
                    let opened = feed.take_next().map_err(|e| e.to_string());
                    _ = proxy.send_event(Told::Opened(opened));
                });
            }
        }
    }

    /// Puts a camera into the clipboard, and on standard output, where it can be had without one.
    fn copy(&mut self, camera: String) {
        _ = writeln!(std::io::stdout(), "{camera}");
        if self.clipboard.is_none() {
            self.clipboard = Clipboard::new().ok();
        }
        let copied = self.clipboard.as_mut().is_some_and(|c| c.set_text(camera.as_str()).is_ok());
        let place = if copied { "copied and printed" } else { "no clipboard; printed" };
        self.show.state.say(format!("{place}: {camera}"));
    }

    /// Writes the picture as fine as it gets, on threads of its own: the walk goes on.
    fn screenshot(&mut self) {
        let state = &mut self.show.state;
        let Some(shown) = state.shown().cloned() else { return };
        let whole = state.is_done();
        let pass = Pass { coarse: 1, samples: vlf::look::render::Options::default().samples };
        let (camera, method) = (state.camera(), shown.taken.shot.method);
        let job = Job::Take(Shot { camera, pass, method }, shown.look);
        let (source, proxy) = (self.show.feed.now(), self.proxy.clone());
        let (folder, stem) = self.show.shots.clone();
        state.say("taking the picture".into());
        thread::spawn(move || {
            let frame = match whole {
                true => Some(shown),
                // Among the walk's own threads its frames would wait until this one is done.
                false => ThreadPoolBuilder::new()
                    .num_threads(rayon::current_num_threads().div_ceil(2))
                    .build()
                    .ok()
                    .and_then(|own| {
                        own.install(|| {
                            paint(&source, &job, &AtomicBool::new(false), &mut Spare::default())
                        })
                    }),
            };
            let Some(frame) = frame else {
                _ = proxy.send_event(Told::Say("no picture: there are no threads for it".into()));
                return;
            };
            let said = match shots::save(&folder, &stem, &frame) {
                Ok(path) => format!("saved {} and .exr", path.display()),
                Err(e) => format!("not saved: {e}"),
            };
            _ = proxy.send_event(Told::Say(said));
        });
    }

    fn capture(&mut self, on: bool) {
        let Some(window) = self.window() else { return };
        let mode = |mode| window.set_cursor_grab(mode).is_ok();
        // Some systems can hold the pointer in its place, others only in the window.
        let held = on && (mode(CursorGrabMode::Locked) || mode(CursorGrabMode::Confined));
        if !held {
            mode(CursorGrabMode::None);
        }
        window.set_cursor_visible(!held);
        self.captured = held;
        self.show.state.say(match (on, held) {
            (true, true) => "the mouse looks around; Esc lets it go".into(),
            (true, false) => "this system does not let the mouse be captured".into(),
            _ => String::new(),
        });
        self.redraw();
    }

    fn button(&mut self, down: bool) {
        match (down, self.drag.take()) {
            (true, _) => self.drag = Some(0.0),
            (false, Some(way)) if way < CLICK && !self.captured => self.capture(true),
            _ => {}
        }
    }

    fn pointer(&mut self, to: PhysicalPosition<f64>) {
        let (x, y) = (to.x - self.pointer.x, to.y - self.pointer.y);
        self.pointer = to;
        let scale = self.window().map_or(1.0, Window::scale_factor);
        if self.captured {
            return;
        }
        if let Some(way) = &mut self.drag {
            *way += x.hypot(y);
            if *way >= CLICK {
                self.show.state.drag(x / scale, y / scale);
            }
        }
    }

    /// Puts the last picture and the text into the window.
    fn draw(&mut self) -> Result<(), WindowError> {
        let Some(size) = self.size() else { return Ok(()) };
        let lines = self.show.state.lines(&self.show.feed.now(), &self.show.feed.news());
        let Some(surface) = &mut self.surface else { return Ok(()) };
        let [Some(width), Some(height)] = [size.0, size.1].map(NonZeroU32::new) else {
            return Ok(());
        };
        let scale = surface.window().scale_factor();
        let failed = |e: SoftBufferError| WindowError::Failed(e.to_string());
        surface.resize(width, height).map_err(failed)?;
        let mut buffer = surface.buffer_mut().map_err(failed)?;
        match self.show.state.shown() {
            Some(frame) => enlarge(frame, size, &mut buffer),
            None => buffer.fill(0),
        }
        write(&lines, size, scale, &mut buffer);
        buffer.present().map_err(failed)
    }
}

impl ApplicationHandler<Told> for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        events.set_control_flow(ControlFlow::Wait);
        let attributes = Window::default_attributes()
            .with_title(self.show.title.clone())
            .with_inner_size(PhysicalSize::new(self.show.size.0, self.show.size.1));
        let window = match events.create_window(attributes) {
            Ok(window) => Rc::new(window),
            Err(e) => return self.fail(events, WindowError::NoDisplay(plain(&e.to_string()))),
        };
        self.inner = window.inner_size();
        match Surface::new(&self.context, window) {
            Ok(surface) => self.surface = Some(surface),
            Err(e) => return self.fail(events, WindowError::NoDisplay(e.to_string())),
        }
        self.pump(events);
    }

    fn user_event(&mut self, events: &ActiveEventLoop, told: Told) {
        match told {
            Told::Done(job, frame) => {
                self.under_way = false;
                if let Some(frame) = frame {
                    self.show.state.took(&job, frame);
                }
            }
            Told::News => {}
            Told::Say(said) => self.show.state.say(said),
            Told::Opened(Ok(())) => {
                self.show.state.say(String::new());
                self.show.state.another_source();
            }
            Told::Opened(Err(why)) => self.show.state.say(format!("cannot be opened: {why}")),
        }
        self.redraw();
        self.pump(events);
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => return events.exit(),
            WindowEvent::Destroyed => {
                self.surface = None;
                return events.exit();
            }
            WindowEvent::Resized(size) => {
                self.inner = size;
                self.redraw();
            }
            // Keys released while another window has the keyboard are never heard of.
            WindowEvent::Focused(false) => {
                self.show.state.let_go();
                self.drag = None;
                if self.captured {
                    self.capture(false);
                }
            }
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            WindowEvent::KeyboardInput { event, .. } if !event.repeat => self.key(events, &event),
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                self.button(state == ElementState::Pressed);
            }
            WindowEvent::CursorMoved { position, .. } => self.pointer(position),
            WindowEvent::MouseWheel { delta, .. } => {
                self.show.state.wheel(match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                    MouseScrollDelta::PixelDelta(way) => way.y / 50.0,
                });
                self.redraw();
            }
            WindowEvent::RedrawRequested => {
                if let Err(failure) = self.draw() {
                    self.fail(events, failure);
                }
                return;
            }
            _ => return,
        }
        self.pump(events);
    }

    fn device_event(&mut self, events: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let DeviceEvent::MouseMotion { delta: (x, y) } = event
            && self.captured
        {
            self.show.state.look_around(x, y);
            self.pump(events);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_no_source_file() {
        assert_eq!(
            plain("os error at /a/b/mod.rs:765: DISPLAY is not set."),
            "DISPLAY is not set."
        );
        assert_eq!(plain("something else: odd"), "something else: odd");
    }

    #[test]
    fn the_window_librarys_keys_have_the_names_of_browsers() {
        use winit::keyboard::KeyCode;
        for (code, name) in [
            (KeyCode::KeyW, "KeyW"),
            (KeyCode::ArrowUp, "ArrowUp"),
            (KeyCode::Digit3, "Digit3"),
            (KeyCode::NumpadAdd, "NumpadAdd"),
            (KeyCode::ShiftLeft, "ShiftLeft"),
            (KeyCode::F1, "F1"),
            (KeyCode::Escape, "Escape"),
            (KeyCode::Space, "Space"),
        ] {
            assert_eq!(format!("{code:?}"), name);
        }
    }
}
