//! The pictures of the viewer in the documents: `docs/pictures RUN` makes them again, by a browser that does what a reader
//! would do. Without `STILLROOM_SCREENSHOTS=FOLDER` and `STILLROOM_RUN=RUN` nothing is made.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use system_tests::{Browser, Viewer, Workshop};

/// Sizes that a page of text takes without waiting, bytes.
const PICTURE_MAX: usize = 240_000;
const FILM_MAX: usize = 1_500_000;

#[test]
fn the_pictures_of_the_documents_are_made_where_they_are_asked_for() {
    let named = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let (Some(folder), Some(run)) = (named("STILLROOM_SCREENSHOTS"), named("STILLROOM_RUN")) else { return };
    let run = std::path::absolute(run).expect("a run folder");
    let mut browser = Browser::start().expect("Chromium has to be installed for this");
    let workshop = Workshop::new();
    let viewer = Viewer::start(&workshop, &[run.to_str().expect("a name that is text")]);
    browser.keep_downloads_in(&workshop.path(""));
    browser.resize(1280, 800);
    browser.open(&viewer.page());
    browser.wait_for("Number(document.querySelector('[data-figure=\"episode/success\"]')?.dataset.points) > 1");
    browser.wait_for("[...document.querySelectorAll('.tiles canvas')].every(({ dataset }) => dataset.step)");
    keep(&mut browser, &folder, "view.png");

    // What it is about: the target is fetched, and nothing else moves. Long episodes make long films.
    let name = browser.value("location.hash.split('/')[2]");
    let name = name.as_str().expect("a name").to_owned();
    let filters = "outcome=success-without-disturbance&range=length&least=12&most=30&sort=length&descending=true";
    browser.value(&format!("location.hash = '#/run/{name}/episodes?{filters}'"));
    browser.wait_for("document.querySelector('table.episodes tr.link a')");
    browser.value("document.querySelector('table.episodes tr.link a').click()");
    browser.wait_for("document.querySelector('canvas.orbit')?.dataset.fine === '0'");
    browser.press("End");
    browser.wait_for(
        "document.querySelector('canvas.orbit').dataset.fine === document.querySelector('input[type=range]').max",
    );
    // The word that tells of drawing fades.
    browser.wait_for(
        "!document.querySelector('.waits') && getComputedStyle(document.querySelector('.busy')).opacity === '0'",
    );
    keep(&mut browser, &folder, "view-episode.png");
    browser.value("document.querySelector('.film').nextElementSibling.value = 'gif'");
    let key = browser.value("location.hash.split('?')[0].split('/').at(-1)");
    let file = format!("{name}-{}.gif", key.as_str().expect("a key"));
    let film = browser.download(".film", &workshop.path(""), &file);
    assert!(film.len() < FILM_MAX, "the film has {} bytes: choose a shorter episode", film.len());
    std::fs::write(folder.join("view-episode.gif"), film).expect("a folder of pictures");
    workshop.call(&["report", run.to_str().expect("a name that is text"), "--out", "page"]).good();
    browser.open(&format!("file://{}", workshop.path("page/report.html").display()));
    browser.wait_for("document.querySelector('#episode img')?.complete");
    keep(&mut browser, &folder, "report.png");
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    assert!(viewer.stop());
}

/// A picture in 256 colours: the box of all its colours is halved again and again, the part first that errs most, and a part's
/// commonest colour stands for the others.
fn in_few_colours(picture: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(Cursor::new(picture)).read_info().expect("a picture");
    let mut pixels = vec![0; reader.output_buffer_size().expect("it fits the memory")];
    let info = reader.next_frame(&mut pixels).expect("a picture");
    let colours = || pixels.chunks_exact(info.color_type.samples()).map(|pixel| [pixel[0], pixel[1], pixel[2]]);
    let mut counts: BTreeMap<[u8; 3], u32> = BTreeMap::new();
    colours().for_each(|colour| *counts.entry(colour).or_default() += 1);
    let mut parts = vec![counts.into_iter().collect::<Vec<_>>()];
    let side = |part: &[([u8; 3], u32)]| {
        let length = |channel: usize| {
            let values = || part.iter().map(|(colour, _)| colour[channel]);
            values().max().unwrap_or(0) - values().min().unwrap_or(0)
        };
        (0..3).map(|channel| (length(channel), channel)).max().expect("three channels")
    };
    let error = |part: &[([u8; 3], u32)]| {
        let length = u64::from(side(part).0);
        length * length * part.iter().map(|(_, count)| u64::from(*count)).sum::<u64>()
    };
    while parts.len() < 256 {
        let errors = parts.iter().map(|part| error(part)).enumerate();
        let (at, most) = errors.max_by_key(|(_, error)| *error).expect("a part");
        if most == 0 {
            break;
        }
        let (_, channel) = side(&parts[at]);
        parts[at].sort_unstable_by_key(|(colour, _)| colour[channel]);
        let middle = |part: &[([u8; 3], u32)]| {
            let ends = [part[0], part[part.len() - 1]].map(|(colour, _)| u16::from(colour[channel]));
            part.partition_point(|(colour, _)| 2 * u16::from(colour[channel]) <= ends[0] + ends[1])
        };
        let half = middle(&parts[at]);
        let other = parts[at].split_off(half);
        parts.push(other);
    }
    let commonest = |part: &Vec<([u8; 3], u32)>| part.iter().max_by_key(|(_, count)| *count).expect("a colour").0;
    let palette: Vec<u8> = parts.iter().flat_map(commonest).collect();
    let places = parts.iter().zip(0..=255).flat_map(|(part, at)| part.iter().map(move |(colour, _)| (*colour, at)));
    let places: BTreeMap<[u8; 3], u8> = places.collect();
    let indexed: Vec<u8> = colours().map(|colour| places[&colour]).collect();
    let mut small = Vec::new();
    let mut encoder = png::Encoder::new(&mut small, info.width, info.height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_palette(palette);
    encoder.set_compression(png::Compression::High);
    encoder.write_header().and_then(|mut writer| writer.write_image_data(&indexed)).expect("memory");
    small
}

fn keep(browser: &mut Browser, folder: &Path, name: &str) {
    let picture = in_few_colours(&browser.screenshot());
    assert!(picture.len() < PICTURE_MAX, "{name} has {} bytes", picture.len());
    std::fs::write(folder.join(name), picture).expect("a folder of pictures");
}
