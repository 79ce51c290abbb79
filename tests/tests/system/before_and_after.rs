//! One episode before and after a run's second stage: side by side in the viewer, saved as films, and in the report.

use proto::checkpoint::Manifest;
use proto::run_folder::RunFolder;
use std::path::PathBuf;
use system_tests::{Browser, Viewer, Workshop, complete};

/// Height of the lines below a film's pictures, pixels.
const CAPTION: u32 = 44;
const FRAMES: u64 = 600;

/// The checkpoint at the end of the first stage.
fn at_stage_end(folder: &RunFolder) -> PathBuf {
    let files = std::fs::read_dir(folder.checkpoints()).expect("checkpoints").flatten().map(|entry| entry.path());
    let manifests = files.filter(|path| path.extension().is_some_and(|extension| extension == "json"));
    let frames = |path: &PathBuf| Manifest::read(path).map_or(u64::MAX, |manifest| manifest.frames);
    let earliest = manifests.min_by_key(frames).expect("a manifest");
    assert!(frames(&earliest) < FRAMES, "the checkpoint of the stage's end is kept");
    earliest
}

/// A run, and recorded evaluations of its weights at the end of both stages on the same episodes.
fn evaluated() -> Workshop {
    let workshop = Workshop::new();
    let mut command = workshop.up("run", 2, 2, FRAMES);
    // Short episodes make short films.
    command.args(["--set", "episode.max_steps=5"]);
    complete(command).result();
    let boundary = at_stage_end(&workshop.run("run").folder);
    for (subject, out) in [(boundary.to_str().expect("text"), "before"), ("run", "after")] {
        let arguments = ["eval", subject, "--split", "test", "--episodes", "2", "--seed", "7", "--record", "all"];
        workshop.call(&[&arguments[..], &["--out", out]].concat()).good();
    }
    workshop
}

#[test]
fn an_episode_of_two_checkpoints_is_compared_filmed_and_reported() {
    let workshop = evaluated();
    the_report_shows_it(&workshop);
    let Some(mut browser) = Browser::start() else { return };
    browser.keep_downloads_in(&workshop.path(""));
    the_report_s_page_is_whole(&workshop, &mut browser);
    side_by_side(&workshop, &mut browser);
    seeds_draw_other_episodes(&workshop, &mut browser);
    assert_eq!(browser.complaints, Vec::<String>::new(), "the pages' console has no error");
}

fn the_report_shows_it(workshop: &Workshop) {
    workshop.call(&["report", "run", "before", "after", "--out", "report"]).good();
    let numbers = std::fs::read_to_string(workshop.path("report/report.json")).expect("numbers");
    assert!(!numbers.contains("no episode can be shown"), "{numbers}");
}

/// Two strips on the page: each from its first step to its last.
fn the_report_s_page_is_whole(workshop: &Workshop, browser: &mut Browser) {
    browser.open(&format!("file://{}", workshop.path("report/report.html").display()));
    browser.wait_for("document.querySelectorAll('#episode-1 .strip-frames').length === 2");
    let words = browser.value(
        "[...document.querySelectorAll('#episode-1 .strip-frames')].map((strip) => [strip.previousSibling.textContent, \
         ...[strip.firstChild, strip.lastChild].map((one) => one.innerText)])",
    );
    for (strip, when) in words.as_array().expect("strips").iter().zip(["before stage II", "after stage II"]) {
        let [title, first, last] = [0, 1, 2].map(|at| strip[at].as_str().expect("text"));
        assert!(title.starts_with(when) && first.contains("step 0 of "), "{strip}");
        let mut numbers = last.split([' ', ',']).filter_map(|word| word.parse::<u32>().ok());
        assert_eq!(numbers.next(), numbers.next(), "{when} ends at its last step: {last}");
    }
    browser.resize(1280, 900);
    assert_eq!(browser.value("document.documentElement.scrollWidth <= innerWidth"), true, "nothing scrolls sideways");
    browser.resize(400, 800);
    let cut = "[...document.querySelectorAll('.fold')].filter((one) => one.scrollWidth > one.parentElement.clientWidth).length";
    assert_eq!(browser.value(cut), 0, "tables are folded on a phone");
    assert_eq!(browser.value("document.documentElement.scrollWidth <= innerWidth"), true, "nor does a phone");
    browser.resize(1280, 900);
    // What the pictures show is there: a picture that cannot be decoded has no size.
    let sizes = browser.value("[...document.querySelectorAll('#episode-1 img')].map((image) => image.naturalWidth)");
    assert!(sizes.as_array().is_some_and(|sizes| sizes.iter().all(|width| width == 320)), "{sizes}");
    let picture = browser.download("#episode-1 .save", &workshop.path(""), "episode-1.png");
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 10_000, "{} bytes", picture.len());
}

fn side_by_side(workshop: &Workshop, browser: &mut Browser) {
    let viewer = Viewer::start(workshop, &["--compare", "before", "after"]);
    browser.open(&viewer.page());
    browser.wait_for("document.querySelectorAll('.twins canvas.orbit').length === 2");
    let last = browser.value("document.querySelector('input[type=range]').max");
    let last: u32 = last.as_str().and_then(|last| last.parse().ok()).expect("a number");
    // The same fixed episode: both have one target, and both are told of under their own name.
    let shown = browser.value("[...document.querySelectorAll('.twins section')].map((one) => one.ariaLabel)");
    assert_eq!(shown, serde_json::json!(["before", "after"]));
    let said = browser.value("document.querySelector('#difference').innerText");
    let said = said.as_str().expect("text");
    assert!(said.contains("isturbance: before ") && said.contains("actions"), "how they differ is said: {said}");
    let proofs = browser.value("document.body.innerText.match(/states are as recorded/g)?.length");
    assert_eq!(proofs, 2, "both are simulated as they were recorded");
    let drawn = |from: u32, to: u32| {
        format!(
            "[...document.querySelectorAll('canvas.orbit')].every(({{ dataset: {{ fine }} }}) => {from} <= Number(fine) && Number(fine) <= {to})"
        )
    };
    let pixels = "[...document.querySelectorAll('canvas.orbit')].map((canvas) => { \
                  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
                  return data.reduce((sum, value) => (sum * 31 + value) % 2147483647, 0); })";
    browser.wait_for(&drawn(0, 0));
    let still = browser.value(pixels);
    assert_eq!(still[0], still[1], "at its start an episode looks the same whoever plays it");
    browser.press("End");
    browser.wait_for(&drawn(1, last));
    let ended = browser.value(pixels);
    browser.value("document.querySelectorAll('canvas.orbit').forEach((canvas) => delete canvas.dataset.fine)");
    browser.drag("canvas.orbit", (90.0, 20.0));
    browser.wait_for(&drawn(1, last));
    let turned = browser.value(pixels);
    assert!(turned[0] != ended[0] && turned[1] != ended[1], "turning one camera turns both");
    films(workshop, browser, last);
    assert!(viewer.stop());
}

/// A run's first episode is another one's with the same seed alone.
fn seeds_draw_other_episodes(workshop: &Workshop, browser: &mut Browser) {
    for (seed, shown) in [
        (5, "document.querySelector('.twins')"),
        (6, "document.body.innerText.includes('no recorded episode in common')"),
    ] {
        let name = format!("seed-{seed}");
        let mut command = workshop.up_seeded(&name, 2, 2, FRAMES, seed);
        command.args(["--set", "episode.max_steps=5"]);
        complete(command).result();
        let viewer = Viewer::start(workshop, &["--compare", "run", &name]);
        browser.open(&viewer.page());
        browser.wait_for(shown);
        // A page that still loads pictures would complain of the viewer's end.
        browser.open("about:blank");
        assert!(viewer.stop());
    }
}

/// The kinds of films that are offered; each is saved, and then looked at on a page that may load it.
fn films(workshop: &Workshop, browser: &mut Browser, last: u32) {
    let kinds =
        browser.value("[...document.querySelector('.film').nextElementSibling.options].map((kind) => kind.value)");
    let kinds: Vec<String> = serde_json::from_value(kinds).expect("a list");
    assert!(kinds.len() == 2 && kinds[1] == "gif", "{kinds:?}");
    browser.value("document.querySelector('[aria-label=\"Steps a second\"]').value = '20'");
    let links =
        "[...document.querySelectorAll('.twins a[href*=\"/episode/\"]')].map((link) => link.href.split('/').at(-1))";
    let keys: Vec<String> = serde_json::from_value(browser.value(links)).expect("a list");
    let mut save = |kind: &str| {
        browser.value(&format!("document.querySelector('.film').nextElementSibling.value = {kind:?}"));
        let name = format!("before-{}-and-after-{}.{kind}", keys[0], keys[1]);
        let film = browser.download(".film", &workshop.path(""), &name);
        browser.wait_for("document.querySelector('.film').disabled === false");
        film
    };
    let [video, gif] = [save(&kinds[0]), save("gif")];
    match kinds[0].as_str() {
        "mp4" => assert_eq!(&video[4..8], b"ftyp"),
        _ => assert_eq!(&video[..4], [0x1a, 0x45, 0xdf, 0xa3]),
    }
    assert_eq!(&gif[..6], b"GIF89a");
    let text = |film: &[u8]| base64::Engine::encode(&base64::prelude::BASE64_STANDARD, film);
    let decoded = format!(
        "(async () => {{ const data = Uint8Array.from(atob('{}'), (letter) => letter.charCodeAt(0)); \
         const decoder = new ImageDecoder({{ data, type: 'image/gif' }}); await decoder.completed; \
         const {{ image }} = await decoder.decode({{ frameIndex: {last} }}); \
         return [decoder.tracks.selectedTrack.frameCount, image.displayWidth, image.displayHeight]; }})()",
        text(&gif)
    );
    let expected = serde_json::json!([last + 1 + 20, 384 + 288, 2 * (288 + CAPTION)]);
    assert_eq!(browser.value(&decoded), expected, "a frame a step, the last for a second more, one above the other");
    // The viewer's own page lets in nothing but its own pictures.
    browser.open("about:blank");
    browser.wait_for("location.href === 'about:blank' && document.readyState === 'complete'");
    let played = format!(
        "new Promise((resolve) => {{ const video = document.createElement('video'); video.muted = true; \
         video.onloadeddata = () => resolve([video.videoWidth, video.videoHeight]); \
         video.onerror = () => resolve(video.error.message); video.src = 'data:video/{};base64,{}'; }})",
        kinds[0],
        text(&video)
    );
    assert_eq!(browser.value(&played), serde_json::json!([640 + 480, 2 * (480 + CAPTION)]));
}
