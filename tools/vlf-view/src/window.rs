//! The window: events in, frames out.
//!
//! While the walker moves, frames are rendered at a part of the resolution that keeps up with the
//! motion; at rest the resolution doubles from frame to frame until it is full, so that a key pressed
//! meanwhile is heard soon.

use crate::walk::{Pressed, Walk};
use softbuffer::{Context, Surface};
use std::num::NonZeroU32;
use std::rc::Rc;
use std::time::{Duration, Instant};
use vlf::Camera;
use vlf::look::image::{Bitmap, Picture};
use vlf::look::tone;
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, OwnedDisplayHandle};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Window, WindowId};

/// Takes the picture that a camera sees, of the camera's size, in linear radiance.
pub type Painter = Box<dyn Fn(&Camera) -> Picture>;

/// What the keys do.
pub const HELP: &str = "\
W A S D, arrows  walk            drag   look around
E, space         up              wheel  walking speed
Q, C             down            + -    exposure, half a stop
shift            hurry           X      exposure from what is seen
F1, ?            this help       Esc    quit";

/// The time that a frame may take while the walker moves.
const MOVING_FRAME: Duration = Duration::from_millis(50);

/// The coarsest frame has one ray for a square of so many pixels a side.
const COARSEST: u32 = 16;

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
    /// Where the walker starts.
    pub walk: Walk,
    /// Size of the window in pixels.
    pub size: (u32, u32),
    /// Exposure in stops; `None` takes it from the first frame.
    pub exposure: Option<f32>,
    /// Where the pictures come from.
    pub painter: Painter,
}

/// Shows the window until it is closed.
///
/// # Errors
/// When there is no display or the window system fails.
pub fn run(show: Show) -> Result<(), WindowError> {
    let events = EventLoop::new().map_err(|e| WindowError::NoDisplay(plain(&e.to_string())))?;
    let context = Context::new(events.owned_display_handle())
        .map_err(|e| WindowError::NoDisplay(e.to_string()))?;
    let mut app = App {
        show,
        context,
        surface: None,
        pressed: Pressed::default(),
        dragging: false,
        pointer: PhysicalPosition::default(),
        turned: false,
        last: Instant::now(),
        pace: Pace::new(),
        failure: None,
    };
    events.run_app(&mut app).map_err(|e| WindowError::Failed(e.to_string()))?;
    app.failure.map_or(Ok(()), Err)
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
    surface: Option<Surface<OwnedDisplayHandle, Rc<Window>>>,
    pressed: Pressed,
    dragging: bool,
    pointer: PhysicalPosition<f64>,
    /// The view turned, or must be drawn again for another reason, since the last frame.
    turned: bool,
    last: Instant,
    pace: Pace,
    failure: Option<WindowError>,
}

/// Chooses how coarse the next frame is: a pixel's ray serves a square of `coarse` pixels a side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pace {
    /// What keeps up with motion.
    moving: u32,
    /// What was shown last; 1 is full resolution.
    shown: u32,
}

impl Pace {
    fn new() -> Pace {
        Pace { moving: 4, shown: 8 }
    }

    /// The next frame's coarseness, or `None` when the full picture is already shown.
    fn next(&self, moving: bool) -> Option<u32> {
        match (moving, self.shown) {
            (true, _) => Some(self.moving),
            (false, 1) => None,
            (false, shown) => Some((shown / 2).max(1)),
        }
    }

    /// Takes note of a frame and the time it took.
    fn took(&mut self, coarse: u32, moving: bool, time: Duration) {
        self.shown = coarse;
        if !moving {
            return;
        }
        if time > MOVING_FRAME {
            self.moving = (self.moving * 2).min(COARSEST);
        } else if time * 6 < MOVING_FRAME {
            // Half as coarse takes four times as long; leave some room, or it would swing.
            self.moving = (self.moving / 2).max(1);
        }
    }
}

impl App {
    fn fail(&mut self, events: &ActiveEventLoop, failure: WindowError) {
        self.failure = Some(failure);
        events.exit();
    }

    fn redraw(&mut self) {
        self.turned = true;
        self.ask();
    }

    fn ask(&self) {
        if let Some(surface) = &self.surface {
            surface.window().request_redraw();
        }
    }

    fn key(&mut self, events: &ActiveEventLoop, code: KeyCode, down: bool) {
        let p = &mut self.pressed;
        match code {
            KeyCode::KeyW | KeyCode::ArrowUp => p.ahead = down,
            KeyCode::KeyS | KeyCode::ArrowDown => p.back = down,
            KeyCode::KeyA | KeyCode::ArrowLeft => p.left = down,
            KeyCode::KeyD | KeyCode::ArrowRight => p.right = down,
            KeyCode::KeyE | KeyCode::Space => p.up = down,
            KeyCode::KeyQ | KeyCode::KeyC => p.down = down,
            KeyCode::ShiftLeft | KeyCode::ShiftRight => p.hurry = down,
            KeyCode::Escape if down => return events.exit(),
            KeyCode::F1 | KeyCode::Slash if down => return eprintln!("{HELP}"),
            KeyCode::Equal | KeyCode::NumpadAdd if down => self.expose(0.5),
            KeyCode::Minus | KeyCode::NumpadSubtract if down => self.expose(-0.5),
            KeyCode::KeyX if down => self.show.exposure = None,
            _ => return,
        }
        // A key that went down is walked from now on, not from the last frame.
        if self.pace.shown == 1 {
            self.last = Instant::now();
        }
        self.redraw();
    }

    fn expose(&mut self, stops: f32) {
        self.show.exposure = self.show.exposure.map(|e| e + stops);
    }

    /// One frame: walk, take the picture, put it in the window, and ask for the next if there is one.
    fn frame(&mut self) -> Result<(), WindowError> {
        let Some(surface) = &mut self.surface else { return Ok(()) };
        let size = surface.window().inner_size();
        let (Some(width), Some(height)) =
            (NonZeroU32::new(size.width), NonZeroU32::new(size.height))
        else {
            return Ok(());
        };
        // A long pause (a window moved, a machine asleep) is no long way.
        let seconds = self.last.elapsed().as_secs_f64().min(0.25);
        self.last = Instant::now();
        let stepped = self.show.walk.step(self.pressed, seconds);
        let moving = stepped || self.turned;
        self.turned = false;
        let start = Instant::now();
        if let Some(coarse) = self.pace.next(moving) {
            let camera =
                self.show.walk.camera(size.width.div_ceil(coarse), size.height.div_ceil(coarse));
            let picture = (self.show.painter)(&camera);
            let ev = *self.show.exposure.get_or_insert_with(|| tone::auto_exposure(&picture));
            let bitmap = tone::develop(&picture, ev);
            self.pace.took(coarse, moving, start.elapsed());
            let failed = |e: softbuffer::SoftBufferError| WindowError::Failed(e.to_string());
            surface.resize(width, height).map_err(failed)?;
            let mut buffer = surface.buffer_mut().map_err(failed)?;
            enlarge(&bitmap, coarse, size.width, &mut buffer);
            buffer.present().map_err(failed)?;
        }
        if stepped || self.pace.next(false).is_some() {
            self.ask();
        }
        Ok(())
    }
}

/// Fills a window's rows of `width` pixels, `0x00RRGGBB`, from a bitmap `coarse` times smaller.
fn enlarge(bitmap: &Bitmap, coarse: u32, width: u32, out: &mut [u32]) {
    for (y, row) in out.chunks_mut(width as usize).enumerate() {
        let from = (y / coarse as usize).min(bitmap.height as usize - 1) * bitmap.width as usize;
        let line = &bitmap.pixels[from..from + bitmap.width as usize];
        for (x, pixel) in row.iter_mut().enumerate() {
            let [r, g, b] = line[x / coarse as usize].map(u32::from);
            *pixel = r << 16 | g << 8 | b;
        }
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        events.set_control_flow(ControlFlow::Wait);
        let attributes = Window::default_attributes()
            .with_title(self.show.title.clone())
            .with_inner_size(PhysicalSize::new(self.show.size.0, self.show.size.1));
        let window = match events.create_window(attributes) {
            Ok(window) => Rc::new(window),
            Err(e) => return self.fail(events, WindowError::NoDisplay(plain(&e.to_string()))),
        };
        match Surface::new(&self.context, window) {
            Ok(surface) => self.surface = Some(surface),
            Err(e) => return self.fail(events, WindowError::NoDisplay(e.to_string())),
        }
        self.redraw();
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::Resized(_) => self.redraw(),
            // Keys released while another window has the keyboard are never heard of.
            WindowEvent::Focused(false) => {
                self.pressed = Pressed::default();
                self.dragging = false;
            }
            WindowEvent::KeyboardInput { event, .. } => {
                if let (PhysicalKey::Code(code), false) = (event.physical_key, event.repeat) {
                    self.key(events, code, event.state == ElementState::Pressed);
                }
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                self.dragging = state == ElementState::Pressed;
            }
            WindowEvent::CursorMoved { position, .. } => {
                if self.dragging {
                    let (x, y) = (position.x - self.pointer.x, position.y - self.pointer.y);
                    self.show.walk.turn(x, y);
                    self.redraw();
                }
                self.pointer = position;
            }
            WindowEvent::MouseWheel { delta, .. } => self.show.walk.faster(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                MouseScrollDelta::PixelDelta(way) => way.y / 50.0,
            }),
            WindowEvent::RedrawRequested => {
                if let Err(failure) = self.frame() {
                    self.fail(events, failure);
                }
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_rest_the_picture_sharpens_and_then_stands() {
        let mut pace = Pace::new();
        let mut seen = Vec::new();
        while let Some(coarse) = pace.next(false) {
            pace.took(coarse, false, Duration::from_secs(1));
            seen.push(coarse);
        }
        assert_eq!(seen, [4, 2, 1]);
    }

    #[test]
    fn moving_frames_become_as_fine_as_the_time_allows() {
        // 1 microsecond a ray over a million pixels: 62 ms at 4 x 4, 16 ms at 8 x 8.
        let mut pace = Pace::new();
        for _ in 0..10 {
            let coarse = pace.next(true).unwrap();
            pace.took(coarse, true, Duration::from_micros(1_000_000 / u64::from(coarse * coarse)));
        }
        assert_eq!(pace.moving, 8);
    }

    #[test]
    fn messages_name_no_source_file() {
        assert_eq!(
            plain("os error at /a/b/mod.rs:765: DISPLAY is not set."),
            "DISPLAY is not set."
        );
        assert_eq!(plain("something else: odd"), "something else: odd");
    }

    #[test]
    fn a_coarse_frame_fills_the_window() {
        let pixels = vec![[1, 2, 3], [4, 5, 6]];
        let mut out = [0; 5 * 3];
        enlarge(&Bitmap { width: 2, height: 1, pixels }, 4, 5, &mut out);
        assert_eq!(out[0], 0x01_02_03);
        assert_eq!(out[3], 0x01_02_03);
        assert_eq!(out[14], 0x04_05_06);
    }
}
