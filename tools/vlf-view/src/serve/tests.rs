use super::*;
use crate::testing::{opening, pack};
use std::io::Read;
use tempfile::TempDir;

/// A server of a small pack at an address.
fn served(address: &str) -> (TempDir, Arc<Server>) {
    let (folder, path) = pack();
    let feed = Arc::new(Feed::open(opening(&path)).unwrap());
    let start = feed.now().start;
    let serve = Serve { feed, path, start, method: Method::Trace, exposure: None };
    let server = Arc::new(Server::bind(serve, address.parse().unwrap()).unwrap());
    (folder, server)
}

fn request(method: &str, path: &str, body: &str) -> Request {
    Request {
        method: method.into(),
        path: path.into(),
        query: String::new(),
        host: "localhost:80".into(),
        site: "same-origin".into(),
        body: body.into(),
    }
}

fn ask(events: &str) -> Request {
    let body =
        format!(r#"{{"session":7,"events":[{events}],"size":[40,30],"coarse":1,"quality":90}}"#);
    request("POST", "/frame", &body)
}

/// What the page is told, and the bytes of the picture.
fn told(answer: &Answer) -> (Value, &[u8]) {
    assert_eq!(answer.code, 200, "{}", String::from_utf8_lossy(&answer.body));
    let (length, rest) = answer.body.split_at(4);
    let length = u32::from_le_bytes(length.try_into().unwrap()) as usize;
    (serde_json::from_slice(&rest[..length]).unwrap(), &rest[length..])
}

#[test]
fn a_page_gets_pictures_until_there_is_none_better_and_the_last_is_exact() {
    let (_folder, server) = served("127.0.0.1:0");
    let mut last = Vec::new();
    let mut passes = 0;
    loop {
        let answer = server.answer(&ask(""));
        let (told, picture) = told(&answer);
        if picture.is_empty() {
            assert_eq!(told["done"], true);
            break;
        }
        passes += 1;
        assert_eq!(told["size"], json!([40, 30]));
        last = picture.to_vec();
    }
    assert!((2..10).contains(&passes), "{passes}");
    let mut reader = png::Decoder::new(io::Cursor::new(last)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let session = server.session(7);
    let walk = lock(&session.walk);
    assert!(pixels == walk.state.shown().unwrap().bitmap.pixels.as_flattened());
}

#[test]
fn what_is_pressed_in_the_page_walks_and_is_answered() {
    let (_folder, server) = served("127.0.0.1:0");
    server.answer(&ask(""));
    let eye = || lock(&server.session(7).walk).state.camera().eye;
    let before = eye();
    server.answer(&ask(r#"{"Key":["KeyW","w",true,false]}"#));
    let input = r#"{"session":7,"events":[{"Key":["KeyW","w",false,false]},"Blur",{"Wheel":1}]}"#;
    assert_eq!(server.answer(&request("POST", "/input", input)).code, 204);
    assert!(eye() != before);
    let answer = server.answer(&ask(r#"{"Key":["KeyJ","j",true,false]},{"Look":[9,1]}"#));
    let camera = told(&answer).0["wishes"][0]["copy"].as_str().unwrap().to_owned();
    Camera::from_json(&camera).unwrap();
    let answer = server.answer(&ask(r#"{"Key":["F1","",true,false]}"#));
    assert!(told(&answer).0["lines"].to_string().contains("full screen"));
}

#[test]
fn odd_requests_are_refused_and_nothing_panics() {
    let (_folder, server) = served("127.0.0.1:0");
    let frame = |body: &str| server.answer(&request("POST", "/frame", body)).code;
    let good = String::from_utf8(ask("").body).unwrap();
    assert_eq!(frame(&good), 200);
    for (from, to) in [
        ("[40,30]", "[0,30]"),
        ("[40,30]", "[40,4097]"),
        ("[40,30]", "[-1,30]"),
        ("[40,30]", "[40]"),
        ("\"quality\":90", "\"quality\":0"),
        ("\"quality\":90", "\"quality\":256"),
        ("\"session\":7", "\"session\":\"7\""),
        ("\"events\":[]", "\"events\":[{\"Jump\":1}]"),
        ("\"events\":[]", "\"events\":[{\"Drag\":[1e999,0]}]"),
        ("{", ""),
    ] {
        assert_eq!(frame(&good.replace(from, to)), 400, "{to}");
    }
    // As odd as they are, these are answered.
    for (from, to) in [
        ("\"coarse\":1", "\"coarse\":4294967295"),
        ("\"coarse\":1", "\"coarse\":0"),
        ("[40,30]", "[1,1]"),
        ("\"events\":[]", "\"events\":[{\"Drag\":[1e308,-1e308]},{\"Wheel\":-1e308}]"),
        ("\"events\":[]", "\"events\":[{\"Key\":[\"Digit99\",\"\u{4e2d}\",true,true]}]"),
    ] {
        assert_eq!(frame(&good.replace(from, to)), 200, "{to}");
    }
    assert_eq!(server.answer(&request("GET", "/../walk.js", "")).code, 404);
    assert_eq!(server.answer(&request("DELETE", "/", "")).code, 404);
    for id in 0..50 {
        server.session(id);
    }
    assert_eq!(lock(&server.walks).len(), MOST_WALKS);
}

#[test]
fn strangers_are_refused() {
    let (_folder, server) = served("127.0.0.1:0");
    let code = |host: &str, site: &str| {
        let (host, site) = (host.to_owned(), site.to_owned());
        server.answer(&Request { host, site, ..request("GET", "/", "") }).code
    };
    for host in ["localhost", "LOCALHOST:1", "127.0.0.1:8080", "127.1.2.3", "[::1]:8080"] {
        assert_eq!(code(host, "none"), 200, "{host}");
    }
    for host in ["", "example.org", "127.0.0.1.example.org", "192.168.0.1", "[::1", "[fe80::1]"] {
        assert_eq!(code(host, "none"), 403, "{host}");
    }
    assert_eq!(code("localhost", "cross-site"), 403);

    let (_folder, server) = served("0.0.0.0:0");
    let token = server.token.clone().unwrap();
    assert!(server.address().unwrap().ends_with(&token) && token.len() > 32);
    let code = |query: &str| {
        let query = query.to_owned();
        server.answer(&Request { query, ..request("GET", "/", "") }).code
    };
    assert_eq!(code(&token), 200);
    for query in ["", "token=", &token[..token.len() - 1], &format!("{token}0"), "token=x&y"] {
        assert_eq!(code(query), 403, "{query}");
    }
    assert_ne!(served("0.0.0.0:0").1.token.clone().unwrap(), token);
}

#[test]
fn connections_beyond_the_bound_are_turned_away_and_broken_ones_do_no_harm() {
    let (_folder, server) = served("127.0.0.1:0");
    let address = server.listener.local_addr().unwrap();
    let server = Arc::into_inner(server).unwrap();
    thread::spawn(move || server.run());
    let ask = |bytes: &[u8]| {
        let mut stream = TcpStream::connect(address).unwrap();
        // Whoever is turned away may find the connection closed already.
        stream.write_all(bytes).ok();
        stream.shutdown(std::net::Shutdown::Write).ok();
        let mut said = String::new();
        stream.read_to_string(&mut said).ok();
        said
    };
    let good = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
    assert!(ask(good).starts_with("HTTP/1.1 200 OK\r\n"));
    assert!(ask(b"\0\0\0\0").starts_with("HTTP/1.1 400 "));
    assert_eq!(ask(b"GET / HT"), "");
    let idle: Vec<_> =
        (0..MOST_CONNECTIONS).map(|_| TcpStream::connect(address).unwrap()).collect();
    // They are counted when they are accepted, one after the other.
    let full = (0..100).any(|_| ask(good).starts_with("HTTP/1.1 503 "));
    assert!(full);
    drop(idle);
    let again = (0..100).any(|_| {
        thread::sleep(Duration::from_millis(20));
        ask(good).starts_with("HTTP/1.1 200 ")
    });
    assert!(again);
}
