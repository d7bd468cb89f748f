//! Progress on standard error: a bar with the time left on a terminal, a quiet line now and then
//! elsewhere.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};
use vlf::bake::Progress;
use vlf::format::manifest::Phase;

/// Seconds between lines where there is no terminal.
const QUIET: Duration = Duration::from_secs(10);

/// What shows how far something has come.
pub struct Bar {
    bar: ProgressBar,
    terminal: bool,
    started: Instant,
    state: Mutex<State>,
}

struct State {
    /// Work done when this run began, so that a resumed bake's time left is right.
    first: Option<f64>,
    line: Instant,
    cycle: Option<(Phase, u32)>,
}

impl Bar {
    /// Begins with a name for what is being done.
    pub fn new(name: &'static str) -> Bar {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{prefix:>10} [{bar:32}] {msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(name);
        let state = State { first: None, line: Instant::now(), cycle: None };
        Bar { bar, terminal, started: Instant::now(), state: Mutex::new(state) }
    }

    /// Shows a finished part in [0, 1].
    pub fn part(&self, part: f32) {
        self.show(f64::from(part), String::new());
    }

    /// Shows how far a bake has come. The whole is the expected number of cycles, weighted by their
    /// grids; the last sweep counts as two grids.
    pub fn bake(&self, p: &Progress) {
        let inside = f64::from(p.done) / f64::from(p.directions);
        let (done, all) = match p.phase {
            Phase::Propagating => {
                let cycles = p.expected_cycles.unwrap_or(p.cycle + 6).max(p.cycle + 1);
                let later = f64::from(cycles - p.cycle - 1) * f64::from(p.perturbations.min(2));
                let own = f64::from(p.perturbations);
                (own * inside, own + later + 2.0)
            }
            _ => (2.0 * inside, 2.0),
        };
        // Only what this run does is timed, so the whole of it shrinks from cycle to cycle.
        let (seconds_a_grid, left) = (self.rate(p, done), all - done);
        let what = match p.phase {
            Phase::Propagating => format!(
                "cycle {}: {} of {} directions, {:.2} % of the light unshot",
                p.cycle + 1,
                p.done,
                p.directions,
                100.0 * p.unshot
            ),
            _ => format!("total maps: {} of {} directions", p.done, p.directions),
        };
        let left = seconds_a_grid.map_or(String::new(), |s| {
            format!(", about {} left", HumanDuration(Duration::from_secs_f64(s * left)))
        });
        self.show(inside, format!("{what}{left}"));
    }

    /// Seconds a grid of directions takes, measured within the step under way.
    fn rate(&self, p: &Progress, done: f64) -> Option<f64> {
        let mut state = self.state.lock().ok()?;
        if state.cycle != Some((p.phase, p.cycle)) {
            state.cycle = Some((p.phase, p.cycle));
            state.first = Some(done);
            state.line = Instant::now();
            self.bar.reset_elapsed();
            return None;
        }
        let done = done - state.first?;
        (done > 0.0).then(|| self.bar.elapsed().as_secs_f64() / done)
    }

    fn show(&self, part: f64, message: String) {
        self.bar.set_position((1000.0 * part) as u64);
        if !self.terminal && !message.is_empty() {
            let Ok(mut state) = self.state.lock() else { return };
            if state.line.elapsed() >= QUIET || part >= 1.0 {
                state.line = Instant::now();
                let _ = writeln!(std::io::stderr(), "{}", message);
            }
        }
        self.bar.set_message(message);
    }

    /// Takes the bar away; returns how long it stood.
    pub fn end(&self) -> Duration {
        self.bar.finish_and_clear();
        self.started.elapsed()
    }
}

/// A line on standard error.
pub fn tell(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
