use super::*;
use crate::pace::Pass;
use crate::paint::{Job, Look, Method, Shot, Spare, paint};
use crate::testing::{CYCLES, bake, opening, pack};
use std::collections::BTreeSet;
use std::fs;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::thread;
use vlf::look::tone::Curve;

/// A small picture from where one starts, its mean radiance, and how many maps are damaged.
fn look(source: &Source, method: Method) -> (f32, usize) {
    let camera = Camera { width: 24, height: 18, ..source.start };
    let shot = Shot { camera, pass: Pass { coarse: 1, samples: 1 }, method };
    let look = Look { exposure: Some(0.0), curve: Curve::Plain };
    let frame =
        paint(source, &Job::Take(shot, look), &AtomicBool::new(false), &mut Spare::default())
            .unwrap();
    let pixels = &frame.taken.picture.pixels;
    (pixels.iter().map(|p| p.mean()).sum::<f32>() / pixels.len() as f32, frame.taken.damaged)
}

#[test]
fn a_field_is_shown_while_it_is_baked_and_each_generation_is_offered() {
    let folder = tempfile::tempdir().unwrap();
    let field = folder.path().join("box.field");
    // The bake waits in each cycle until it has been looked at.
    let (step, steps) = channel();
    let (go, going) = channel::<()>();
    let waits = Mutex::new((None, going));
    let baked = field.clone();
    let baker = thread::spawn(move || {
        bake(&baked, &|progress| {
            let (cycle, going) = &mut *waits.lock().unwrap();
            if cycle.replace(progress.cycle) != Some(progress.cycle) {
                step.send(()).unwrap();
                going.recv().unwrap();
            }
        });
    });
    let mut feed: Option<Feed> = None;
    let mut shown = BTreeSet::new();
    let mut brightness = Vec::new();
    while steps.recv().is_ok() {
        let feed = match &feed {
            Some(feed) => feed,
            None => feed.insert(Feed::open(opening(&field)).unwrap()),
        };
        if feed.check() {
            let news = feed.news();
            assert_eq!(news.trouble, None);
            assert!(news.offer.expect("an offer").contains("N takes it"));
            feed.take_next().unwrap();
            assert_eq!(feed.news(), News::default());
        }
        let source = feed.now();
        assert!(!source.field.is_finished());
        if shown.insert(source.field.manifest.cycle) {
            brightness.push(look(&source, Method::Trace).0);
        }
        go.send(()).unwrap();
    }
    baker.join().unwrap();
    let feed = feed.unwrap();
    assert!(feed.check());
    let News { trouble, offer } = feed.news();
    assert!(offer.is_some_and(|o| o.contains("finished")), "{trouble:?}");
    feed.take_next().unwrap();
    assert!(feed.now().field.is_finished() && !feed.check());
    assert_eq!(look(&feed.now(), Method::Field).1, 0);
    // Each generation has the light of one more bounce.
    assert!(shown.len() >= CYCLES as usize, "{shown:?}");
    assert!(brightness.windows(2).all(|two| two[1] > two[0]), "{brightness:?}");
}

#[test]
fn a_pack_that_is_replaced_is_offered_and_what_was_open_stays() {
    let (folder, pack) = pack();
    let feed = Feed::open(opening(&pack)).unwrap();
    assert!(!feed.check());
    let before = look(&feed.now(), Method::Trace);
    let other = folder.path().join("other.vlf");
    fs::copy(&pack, &other).unwrap();
    fs::rename(&other, &pack).unwrap();
    assert!(feed.check() && !feed.check());
    let news = feed.news();
    assert!(news.trouble.unwrap().contains("replaced") && news.offer.is_some());
    assert_eq!(look(&feed.now(), Method::Field).1, 0);
    feed.take_next().unwrap();
    assert_eq!((feed.news(), look(&feed.now(), Method::Trace)), (News::default(), before));
    fs::remove_file(&pack).unwrap();
    assert!(feed.check());
    assert!(feed.news().trouble.unwrap().contains("gone") && feed.news().offer.is_none());
    assert!(feed.take_next().is_err());
    assert_eq!(look(&feed.now(), Method::Trace), before);
}

#[test]
fn a_pack_that_is_cut_short_is_a_message_and_magenta_pixels() {
    let (_folder, pack) = pack();
    let feed = Feed::open(opening(&pack)).unwrap();
    let whole = look(&feed.now(), Method::Trace);
    let file = fs::OpenOptions::new().write(true).open(&pack).unwrap();
    file.set_len(4096).unwrap();
    assert!(feed.check() && feed.news().trouble.unwrap().contains("cut short"));
    let (_, damaged) = look(&feed.now(), Method::Field);
    assert!(damaged > 0);
    // What needs none of the maps is as it was.
    assert_eq!(look(&feed.now(), Method::Trace).0, whole.0);
    let error = feed.take_next().unwrap_err().to_string();
    assert!(error.contains("box.vlf"), "{error}");
    assert!(feed.now().field.is_finished());
}
