//! The pictures of the viewer in the documents: `docs/pictures RUN` makes them again, by a browser that does what a reader
//! would do. Without `STILLROOM_SCREENSHOTS=FOLDER` and `STILLROOM_RUN=RUN` nothing is made.

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
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    assert!(viewer.stop());
}

fn keep(browser: &mut Browser, folder: &Path, name: &str) {
    let picture = browser.screenshot();
    assert!(picture.len() < PICTURE_MAX, "{name} has {} bytes", picture.len());
    std::fs::write(folder.join(name), picture).expect("a folder of pictures");
}
