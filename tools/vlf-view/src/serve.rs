//! `--serve`: the walkthrough in a browser. Page and client are in this program, frames are rendered
//! here, and every page has a walk of its own.
//!
//! On a loopback address only pages of this machine are answered. On any other, whoever has the token
//! in the address is.

use crate::http::{self, Answer, Refusal, Request, SILENCE};
use crate::paint::{Frame, Method, Spare, paint};
use crate::source::Feed;
use crate::state::{Walkthrough, Wish};
use crate::views::Views;
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use vlf::Camera;
use vlf::look::image::Bitmap;

/// Most connections at a time; a browser has six.
const MOST_CONNECTIONS: usize = 32;

/// Most walks that are remembered.
const MOST_WALKS: usize = 8;

/// Most pixels of a picture, along a row or column.
const MOST_EDGE: u32 = 4096;

/// How often the disk is asked for something newer.
const ASKED: Duration = Duration::from_millis(500);

/// The seconds that the first step of a walk stands for: a frame's.
const FIRST_STEP: f64 = 1.0 / 60.0;

const PAGE: &str = include_str!("page/walk.html");
const STYLE: &str = include_str!("page/walk.css");
const CLIENT: &str = include_str!("page/walk.js");

/// What is served, and how walks start.
pub struct Serve {
    /// What is looked at.
    pub feed: Arc<Feed>,
    /// The field or pack, next to which views are saved.
    pub path: PathBuf,
    /// Where walks start.
    pub start: Camera,
    /// How they show things at first.
    pub method: Method,
    /// Exposure in stops; `None` takes it from the first frame.
    pub exposure: Option<f32>,
}

/// A server that is bound to its address.
pub struct Server {
    serve: Serve,
    listener: TcpListener,
    /// What the query must be, if it must be anything.
    token: Option<String>,
    walks: Mutex<Vec<(u64, Arc<Session>)>>,
    connections: AtomicUsize,
}

/// One page's walk.
struct Session {
    stop: AtomicBool,
    /// One picture at a time.
    painting: Mutex<Spare>,
    walk: Mutex<Walk>,
}

struct Walk {
    state: Walkthrough,
    wishes: Vec<Value>,
    last: Instant,
    idle: bool,
}

/// What happened in the browser.
#[derive(Debug, Deserialize)]
enum Event {
    /// Place, text, whether it went down, whether Ctrl or Shift is down.
    Key(String, String, bool, bool),
    /// The scene was dragged by so many pixels.
    Drag(f64, f64),
    /// The captured mouse went so many pixels.
    Look(f64, f64),
    /// Notches of the wheel.
    Wheel(f64),
    /// Another window has the keyboard.
    Blur,
}

#[derive(Debug, Deserialize)]
struct Input {
    session: u64,
    events: Vec<Event>,
}

#[derive(Debug, Deserialize)]
struct Ask {
    session: u64,
    events: Vec<Event>,
    size: (u32, u32),
    /// Moving frames are as coarse as this or coarser.
    coarse: u32,
    /// Of JPEG, 1 to 100.
    quality: u8,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Server {
    /// Binds an address; port 0 is any that is free.
    ///
    /// # Errors
    /// When it cannot be had.
    pub fn bind(serve: Serve, address: SocketAddr) -> io::Result<Server> {
        let listener = TcpListener::bind(address)?;
        let token = match address.ip().is_loopback() {
            true => None,
            false => Some(format!("token={}", token()?)),
        };
        let (walks, connections) = (Mutex::default(), AtomicUsize::new(0));
        Ok(Server { serve, listener, token, walks, connections })
    }

    /// What a browser is to open.
    pub fn address(&self) -> io::Result<String> {
        let query = self.token.as_ref().map_or(String::new(), |token| format!("?{token}"));
        Ok(format!("http://{}/{query}", self.listener.local_addr()?))
    }

    /// Answers until the process ends.
    pub fn run(self) {
        let server = Arc::new(self);
        let feed = server.serve.feed.clone();
        thread::spawn(move || {
            loop {
                thread::sleep(ASKED);
                feed.check();
            }
        });
        for stream in server.listener.incoming() {
            // A connection that broke while it was being made is none.
            let Ok(stream) = stream else { continue };
            if server.connections.fetch_add(1, Ordering::SeqCst) >= MOST_CONNECTIONS {
                server.connections.fetch_sub(1, Ordering::SeqCst);
                let full = Answer::text(503, "too many connections");
                _ = http::write(&mut &stream, &full, false);
                continue;
            }
            let server = server.clone();
            thread::spawn(move || {
                let _gone = Gone(&server.connections);
                // Whoever has gone is told nothing.
                _ = server.converse(&stream);
            });
        }
    }

    /// Answers the requests of a connection.
    fn converse(&self, stream: &TcpStream) -> io::Result<()> {
        stream.set_read_timeout(Some(SILENCE))?;
        stream.set_write_timeout(Some(SILENCE))?;
        stream.set_nodelay(true)?;
        let mut rest = Vec::new();
        loop {
            match http::read(&mut &*stream, &mut rest) {
                Ok(request) => http::write(&mut &*stream, &self.answer(&request), true)?,
                Err(Refusal::Bad(answer)) => return http::write(&mut &*stream, &answer, false),
                Err(Refusal::Gone) => return Ok(()),
            }
        }
    }

    fn answer(&self, request: &Request) -> Answer {
        if !self.may(request) {
            return Answer::text(403, "not with this address; open the one that vlf-view printed");
        }
        let of = |kind, text: &str| Answer { code: 200, kind, body: text.into() };
        match (request.method.as_str(), request.path.as_str()) {
            ("GET", "/") => {
                let query = self.token.as_deref().unwrap_or("");
                of("text/html; charset=utf-8", &PAGE.replace("QUERY", query))
            }
            ("GET", "/walk.css") => of("text/css; charset=utf-8", STYLE),
            ("GET", "/walk.js") => of("text/javascript; charset=utf-8", CLIENT),
            ("POST", "/frame") => match serde_json::from_slice(&request.body) {
                Ok(ask) => self.frame(ask),
                Err(e) => Answer::text(400, &format!("not a request for a frame: {e}")),
            },
            ("POST", "/input") => match serde_json::from_slice::<Input>(&request.body) {
                Ok(input) => {
                    self.session(input.session).told(&self.serve.feed, input.events);
                    Answer::text(204, "")
                }
                Err(e) => Answer::text(400, &format!("not input: {e}")),
            },
            _ => Answer::text(404, "there is no such thing here"),
        }
    }

    /// Whether whoever asks may: with the token, or from a page of this machine. A page from elsewhere
    /// whose name has been made to lead here has another name in its requests.
    fn may(&self, request: &Request) -> bool {
        let own_page = ["", "none", "same-origin"].contains(&request.site.as_str());
        own_page
            && match &self.token {
                Some(token) => same(&request.query, token),
                None => is_this_machine(&request.host),
            }
    }

    /// A page's walk; a new one for a new page, for which the oldest of too many goes.
    fn session(&self, id: u64) -> Arc<Session> {
        let mut walks = lock(&self.walks);
        let found = walks.iter().position(|(known, _)| *known == id);
        let (_, session) = match found {
            Some(at) => walks.remove(at),
            None => (id, Arc::new(self.begin())),
        };
        walks.push((id, session.clone()));
        if walks.len() > MOST_WALKS {
            walks.remove(0);
        }
        session
    }

    fn begin(&self) -> Session {
        let Serve { feed, path, start, method, exposure } = &self.serve;
        // Others than this machine's user write no files.
        let views = if self.token.is_none() { Views::of(path) } else { Views::default() };
        let state = Walkthrough::new(*start, feed.now().speed, *method, *exposure);
        let walk = Walk {
            state: state.with_views(views),
            wishes: Vec::new(),
            last: Instant::now(),
            idle: true,
        };
        Session { stop: AtomicBool::new(false), painting: Mutex::default(), walk: Mutex::new(walk) }
    }

    fn frame(&self, ask: Ask) -> Answer {
        let (width, height) = ask.size;
        let fits = |n: u32| (1..=MOST_EDGE).contains(&n);
        if !fits(width) || !fits(height) || !(1..=100).contains(&ask.quality) {
            return Answer::text(400, "no such size or quality");
        }
        let session = self.session(ask.session);
        let painted = session.painted(&self.serve.feed, ask.events, (ask.size, ask.coarse));
        match packed(painted, ask.quality) {
            Ok(body) => Answer { code: 200, kind: "application/octet-stream", body },
            Err(e) => Answer::text(400, &format!("no picture: {e}")),
        }
    }
}

/// A picture, if there is a new one, and what the page is to know.
struct Painted {
    frame: Option<Frame>,
    told: Value,
}

impl Session {
    /// Takes note of what happened.
    fn told(&self, feed: &Feed, events: Vec<Event>) {
        let mut walk = lock(&self.walk);
        walk.hear(feed, events);
        if walk.state.is_overtaken() {
            self.stop.store(true, Ordering::Relaxed);
        }
    }

    /// The next picture of a size, no finer than `coarse` while the walker moves.
    fn painted(
        &self,
        feed: &Feed,
        events: Vec<Event>,
        (size, coarse): ((u32, u32), u32),
    ) -> Painted {
        let mut spare = lock(&self.painting);
        let mut events = Some(events);
        loop {
            let source = feed.now();
            let job = {
                let mut walk = lock(&self.walk);
                self.stop.store(false, Ordering::Relaxed);
                walk.hear(feed, events.take().unwrap_or_default());
                walk.state.no_finer(coarse);
                let seconds =
                    if walk.idle { FIRST_STEP } else { walk.last.elapsed().as_secs_f64() };
                walk.last = Instant::now();
                let job = walk.state.next(&source, seconds, size);
                walk.idle = job.is_none();
                job
            };
            let frame = job.as_ref().map(|job| paint(&source, job, &self.stop, &mut spare));
            let mut walk = lock(&self.walk);
            let frame = match (job, frame) {
                (Some(job), Some(Some(frame))) => {
                    walk.state.took(&job, frame.clone());
                    Some(frame)
                }
                // Overtaken: what happened meanwhile is heard, and there is a better one to take.
                (Some(_), _) => continue,
                (None, _) => None,
            };
            let told = json!({
                "done": walk.state.is_done() || frame.is_none(),
                "lines": walk.state.lines(&source, &feed.news()),
                "wishes": std::mem::take(&mut walk.wishes),
            });
            return Painted { frame, told };
        }
    }
}

impl Walk {
    fn hear(&mut self, feed: &Feed, events: Vec<Event>) {
        for event in events {
            match event {
                Event::Key(code, text, down, saves) => {
                    let wish = self.state.key(&code, &text, down, saves);
                    wish.into_iter().for_each(|wish| self.fulfil(feed, wish));
                }
                Event::Drag(x, y) => self.state.drag(x, y),
                Event::Look(x, y) => self.state.look_around(x, y),
                Event::Wheel(notches) => self.state.wheel(notches),
                Event::Blur => self.state.let_go(),
            }
        }
    }

    fn fulfil(&mut self, feed: &Feed, wish: Wish) {
        match wish {
            Wish::Copy(camera) => {
                self.state.say(format!("camera: {camera}"));
                self.wishes.push(json!({"copy": camera}));
            }
            Wish::Screenshot => self.wishes.push(json!({"screenshot": true})),
            Wish::TakeNext => match feed.take_next() {
                Ok(()) => self.state.another_source(),
                Err(e) => self.state.say(format!("cannot be opened: {e}")),
            },
            // The browser does these itself, and its window is not ours to close.
            Wish::Leave | Wish::Capture | Wish::FullScreen => {}
        }
    }
}

/// The length of the JSON in four bytes, the JSON, and the picture: exact when it is as fine as it gets
/// and the link is a good one, else JPEG.
fn packed(Painted { frame, mut told }: Painted, quality: u8) -> anyhow::Result<Vec<u8>> {
    let mut picture = Vec::new();
    if let Some(frame) = frame {
        let shot = &frame.taken.shot;
        told["size"] = json!([shot.camera.width, shot.camera.height]);
        told["coarse"] = json!(shot.pass.coarse);
        told["samples"] = json!(shot.pass.samples);
        told["margin"] = json!(shot.margin());
        told["ms"] = json!(frame.time.as_secs_f64() * 1e3);
        match shot.pass.is_last() && quality >= EXACT {
            true => png_of(&frame.bitmap, &mut picture)?,
            false => jpeg_of(&frame.bitmap, quality, &mut picture)?,
        }
    }
    let told = told.to_string();
    let mut body = (told.len() as u32).to_le_bytes().to_vec();
    body.extend_from_slice(told.as_bytes());
    body.append(&mut picture);
    Ok(body)
}

/// From this quality on, a link can take exact pictures.
const EXACT: u8 = 80;

fn png_of(bitmap: &Bitmap, out: &mut Vec<u8>) -> anyhow::Result<()> {
    let mut encoder = png::Encoder::new(out, bitmap.width, bitmap.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bitmap.pixels.as_flattened())?;
    Ok(writer.finish()?)
}

fn jpeg_of(bitmap: &Bitmap, quality: u8, out: &mut Vec<u8>) -> anyhow::Result<()> {
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(out, quality);
    let pixels = bitmap.pixels.as_flattened();
    Ok(encoder.encode(pixels, bitmap.width, bitmap.height, image::ExtendedColorType::Rgb8)?)
}

/// 128 random bits.
fn token() -> io::Result<String> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|e| io::Error::other(e.to_string()))?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

/// Compares all of it, however much of the beginning is right, so that time tells nothing.
fn same(a: &str, b: &str) -> bool {
    let differing = a.bytes().zip(b.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && differing == 0
}

/// Whether a page's host, with or without a port, is this machine by a loopback address or its name.
fn is_this_machine(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']').map_or("", |(name, _)| name),
        None => host.split_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// A connection that ends.
struct Gone<'a>(&'a AtomicUsize);

impl Drop for Gone<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Serves until the process ends; says where on standard output.
///
/// # Errors
/// When the address cannot be had.
pub fn run(serve: Serve, address: SocketAddr) -> io::Result<()> {
    let server = Server::bind(serve, address)?;
    let mut out = io::stdout();
    writeln!(out, "{}", server.address()?)?;
    out.flush()?;
    server.run();
    Ok(())
}

#[cfg(test)]
mod tests;
