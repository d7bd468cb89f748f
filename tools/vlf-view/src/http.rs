//! The little of HTTP that a page on this machine needs: one request after the other on a connection,
//! everything bounded. Parsing is `httparse`'s.

use std::io::{self, Read, Write};
use std::time::Duration;

/// Most bytes of a request's head.
const MOST_HEAD: usize = 16 << 10;

/// Most bytes of a request's body.
const MOST_BODY: usize = 64 << 10;

/// Most fields of a head.
const MOST_FIELDS: usize = 64;

/// How long a connection may say nothing.
pub const SILENCE: Duration = Duration::from_secs(30);

/// A request.
#[derive(Debug, PartialEq, Eq)]
pub struct Request {
    /// `GET`, `POST` and so on.
    pub method: String,
    /// The path, without what follows a question mark.
    pub path: String,
    /// What follows the question mark.
    pub query: String,
    /// Who is being asked, as the browser has it.
    pub host: String,
    /// Whose page asks, where the browser says so: `same-origin` and others.
    pub site: String,
    /// What came with it.
    pub body: Vec<u8>,
}

/// An answer.
#[derive(Debug)]
pub struct Answer {
    /// The code, such as 200.
    pub code: u16,
    /// What the body is.
    pub kind: &'static str,
    /// The body.
    pub body: Vec<u8>,
}

impl Answer {
    /// A line of text.
    pub fn text(code: u16, text: &str) -> Answer {
        Answer { code, kind: "text/plain; charset=utf-8", body: text.into() }
    }
}

/// Why no request could be read.
#[derive(Debug)]
pub enum Refusal {
    /// The connection has ended, or was silent for too long.
    Gone,
    /// What came is no request that is read here.
    Bad(Answer),
}

impl From<io::Error> for Refusal {
    fn from(_: io::Error) -> Refusal {
        Refusal::Gone
    }
}

/// Reads the next request. `rest` holds what was read beyond the one before.
///
/// # Errors
/// When there is none, or it is beyond the bounds.
pub fn read(stream: &mut dyn Read, rest: &mut Vec<u8>) -> Result<Request, Refusal> {
    let bad = |code, why| Refusal::Bad(Answer::text(code, why));
    let (mut request, length, head) = loop {
        let mut fields = [httparse::EMPTY_HEADER; MOST_FIELDS];
        let mut parsed = httparse::Request::new(&mut fields);
        match parsed.parse(rest) {
            Err(httparse::Error::TooManyHeaders) => return Err(bad(431, "too many fields")),
            Err(_) => return Err(bad(400, "not a request")),
            Ok(httparse::Status::Complete(head)) => {
                let (request, length) = head_of(&parsed)?;
                break (request, length, head);
            }
            Ok(httparse::Status::Partial) if rest.len() >= MOST_HEAD => {
                return Err(bad(431, "too long a head"));
            }
            Ok(httparse::Status::Partial) => more(stream, rest)?,
        }
    };
    while rest.len() < head + length {
        more(stream, rest)?;
    }
    request.body = rest[head..head + length].to_vec();
    rest.drain(..head + length);
    Ok(request)
}

/// A request without its body, and how long that is.
fn head_of(parsed: &httparse::Request<'_, '_>) -> Result<(Request, usize), Refusal> {
    let bad = |code, why| Refusal::Bad(Answer::text(code, why));
    let field = |name: &str| {
        let mut found = parsed.headers.iter().filter(|h| h.name.eq_ignore_ascii_case(name));
        let value = found.next().map(|h| std::str::from_utf8(h.value).unwrap_or("").trim());
        // Two lengths, or two hosts, are one too many.
        if found.next().is_some() { Some("") } else { value }
    };
    if field("transfer-encoding").is_some() {
        return Err(bad(411, "a body needs a length"));
    }
    let length = match field("content-length").map(str::parse::<usize>) {
        None => 0,
        Some(Ok(length)) if length <= MOST_BODY => length,
        Some(Ok(_)) => return Err(bad(413, "too long a body")),
        Some(Err(_)) => return Err(bad(400, "not a length")),
    };
    let target = parsed.path.unwrap_or("");
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let request = Request {
        method: parsed.method.unwrap_or("").to_owned(),
        path: path.to_owned(),
        query: query.to_owned(),
        host: field("host").unwrap_or("").to_owned(),
        site: field("sec-fetch-site").unwrap_or("").to_owned(),
        body: Vec::new(),
    };
    Ok((request, length))
}

fn more(stream: &mut dyn Read, rest: &mut Vec<u8>) -> Result<(), Refusal> {
    let mut piece = [0; 4096];
    match stream.read(&mut piece)? {
        0 => Err(Refusal::Gone),
        count => {
            rest.extend_from_slice(&piece[..count]);
            Ok(())
        }
    }
}

/// Writes an answer, after which the connection goes on or is closed.
///
/// # Errors
/// When the connection has ended.
pub fn write(stream: &mut dyn Write, answer: &Answer, goes_on: bool) -> io::Result<()> {
    let Answer { code, kind, body } = answer;
    let connection = if goes_on { "keep-alive" } else { "close" };
    let head = format!(
        "HTTP/1.1 {code} {}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: {connection}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
         connect-src 'self'; img-src 'self' blob:; frame-ancestors 'none'\r\n\r\n",
        reason(*code),
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

fn reason(code: u16) -> &'static str {
    match code {
        200 => "OK",
        204 => "No Content",
        403 => "Forbidden",
        404 => "Not Found",
        503 => "Service Unavailable",
        _ => "Bad Request",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A connection that gives so many bytes at a time.
    struct Dribble<'a>(&'a [u8], usize);

    impl Read for Dribble<'_> {
        fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
            let count = self.1.min(self.0.len()).min(to.len());
            let (now, later) = self.0.split_at(count);
            to[..count].copy_from_slice(now);
            self.0 = later;
            Ok(count)
        }
    }

    fn code(bytes: &[u8]) -> Option<u16> {
        match read(&mut Dribble(bytes, 1000), &mut Vec::new()) {
            Ok(_) => Some(200),
            Err(Refusal::Bad(answer)) => Some(answer.code),
            Err(Refusal::Gone) => None,
        }
    }

    #[test]
    fn requests_are_read_one_after_the_other_however_they_come() {
        let bytes = b"POST /a?b=c HTTP/1.1\r\nHost: h:1\r\nContent-Length: 3\r\n\r\nxyzGET / HTTP/1.1\r\n\r\n";
        for piece in [1, 7, 1000] {
            let mut stream = Dribble(bytes, piece);
            let mut rest = Vec::new();
            let first = read(&mut stream, &mut rest).unwrap();
            let is = (&*first.method, &*first.path, &*first.query, &*first.host, &*first.body);
            assert_eq!(is, ("POST", "/a", "b=c", "h:1", &b"xyz"[..]));
            assert_eq!(read(&mut stream, &mut rest).unwrap().method, "GET");
            assert!(matches!(read(&mut stream, &mut rest), Err(Refusal::Gone)));
        }
    }

    #[test]
    fn what_is_too_much_or_no_request_is_refused() {
        assert_eq!(code(b""), None);
        assert_eq!(code(b"GET / HTTP/1.1\r\n"), None);
        assert_eq!(code(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03"), Some(400));
        assert_eq!(code(b"GET / HTTP/9\r\n\r\n"), Some(400));
        let with = |field: &str| code(format!("POST / HTTP/1.1\r\n{field}\r\n\r\nxx").as_bytes());
        assert_eq!(with("Content-Length: 2"), Some(200));
        assert_eq!(with("Content-Length: 3"), None);
        assert_eq!(with("Content-Length: 65537"), Some(413));
        for odd in ["-1", "99999999999999999999", "2, 2", "", "two", "2\r\nContent-Length: 2"] {
            assert_eq!(with(&format!("Content-Length: {odd}")), Some(400), "{odd}");
        }
        assert_eq!(with("Transfer-Encoding: chunked"), Some(411));
        assert_eq!(code(format!("GET /{} HTTP/1.1", "x".repeat(MOST_HEAD)).as_bytes()), Some(431));
        let fields = "a: b\r\n".repeat(MOST_FIELDS + 1);
        assert_eq!(code(format!("GET / HTTP/1.1\r\n{fields}\r\n").as_bytes()), Some(431));
    }
}
