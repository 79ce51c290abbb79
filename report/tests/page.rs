//! The page of a report in a headless browser: what fits a screen, which colours things have, what can be taken away.
//!
//! Where no Chromium is installed nothing is tested; `.ci/run` says so.

mod study;

use report::{Options, Report};
use serde_json::{Value, json};
use std::path::Path;
use study::{run, study};
use system_tests::Browser;

/// What a script in the page finds wrong: a list of sentences.
fn findings(browser: &mut Browser, script: &str) -> Vec<String> {
    let found = browser.value(&format!("(() => {{ const found = []; {script}; return found.slice(0, 5); }})()"));
    found.as_array().expect("a list").iter().map(|one| one.as_str().unwrap_or("?").to_owned()).collect()
}

/// What is wider than what it is in, but for what is folded away.
const TOO_WIDE: &str = "for (const box of document.querySelectorAll('.scroll')) \
    if (box.scrollWidth > box.clientWidth) found.push(`${box.innerText.slice(0, 60)}: ${box.scrollWidth} of ${box.clientWidth}`); \
    if (document.documentElement.scrollWidth > innerWidth) found.push(`the page: ${document.documentElement.scrollWidth}`)";

/// Text that is hard to read before what it is on: a contrast of less than 4.5.
const FAINT: &str = "const channels = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map(Number); \
    const luminance = (colour) => { const [r, g, b] = channels(colour).map((value) => { const part = value / 255; \
      return part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const behind = (element) => { for (let at = element; at; at = at.parentElement) { \
      const colour = getComputedStyle(at).backgroundColor; if (!/, 0\\)$|transparent/.test(colour)) return colour; } return 'rgb(255, 255, 255)'; }; \
    const against = (ink, paper, what) => { const [a, b] = [luminance(ink), luminance(paper)].sort((x, y) => y - x); \
      const contrast = (a + 0.05) / (b + 0.05); if (contrast < 4.5) found.push(`${what}: ${contrast.toFixed(1)}, ${ink} on ${paper}`); }; \
    for (const element of document.querySelectorAll('p, li, td, th, h1, h2, h3, a, summary, figcaption, label, small')) \
      if (element.innerText?.trim()) against(getComputedStyle(element).color, behind(element), element.innerText.slice(0, 30))";

fn open(browser: &mut Browser, folder: &Path, report: &Report, episodes: &Value) {
    let values: Vec<f64> = report.groups.iter().map(|_| 0.2).collect();
    let differences = if values.len() > 1 { json!([{ "name": "ppo.clip", "values": values }]) } else { json!([]) };
    let data = json!({ "made": "made for a test", "report": report, "episodes": episodes, "differences": differences });
    let path = folder.join("report.html");
    std::fs::write(&path, view::page::report(&data.to_string(), "")).expect("a writable folder");
    browser.open(&format!("file://{}", path.display()));
    browser.wait_for("document.querySelector('.report')");
}

fn keep(browser: &mut Browser, name: &str) {
    if let Some(kept) = std::env::var_os("STILLROOM_SCREENSHOTS") {
        let picture = browser.screenshot();
        std::fs::write(Path::new(&kept).join(name), picture).expect("a folder of pictures");
    }
}

#[test]
fn the_page_fits_screens_and_gives_its_charts_away() {
    let Some(mut browser) = Browser::start() else { return };
    let mut runs = study();
    for run in &mut runs[..5] {
        // Settings that are not the preset's, a line of them.
        (run.config.actors.count, run.config.actors.environments_per_actor) = (38, 16);
        (run.config.ppo.minibatches, run.config.ppo.rollout_steps, run.config.ppo.clip) = (4, 32, 0.2);
    }
    let report = Report::of(&runs, &Options::default(), Vec::new()).expect("sound runs");
    let folder = tempfile::tempdir().expect("a temporary folder");
    browser.keep_downloads_in(folder.path());
    browser.resize(1280, 900);
    let strip = |run: &str| json!({ "run": run, "task": "arm_point_nav", "caption": "", "strips": [{ "title": "success", "frames": [] }] });
    open(&mut browser, folder.path(), &report, &json!([strip("runs/a"), strip("runs/b")]));
    let headings = browser.value("[...document.querySelectorAll('#episode h3')].map((one) => one.textContent)");
    assert_eq!(headings, json!(["runs/a: success", "runs/b: success"]));
    browser
        .value("[...document.querySelectorAll('.controls label')].find((one) => one.textContent === 'more').click()");
    browser.wait_for("document.querySelectorAll('.chart canvas').length >= 36");
    let differs = browser.value("document.querySelector('#differences table').innerText");
    let differs = differs.as_str().expect("text");
    assert!(differs.contains("ppo.clip") && differs.matches("0.2").count() == report.groups.len(), "{differs}");
    assert_ne!(browser.value("document.querySelectorAll('tr.absent').length"), 0, "rows of the paper without a group");
    browser.value("document.querySelectorAll('details').forEach((one) => { one.open = true; })");
    assert_eq!(findings(&mut browser, TOO_WIDE), [""; 0], "nothing scrolls on a screen of 1280 pixels");
    for (scheme, chosen, bright) in
        [("light", "", true), ("dark", "", false), ("dark", "light", true), ("light", "dark", false)]
    {
        browser.scheme(scheme);
        let choose = format!("document.querySelector('#scheme').value = '{chosen}'");
        browser.value(&format!("{choose}; document.querySelector('#scheme').dispatchEvent(new Event('change'))"));
        let red = browser.value("Number(getComputedStyle(document.body).backgroundColor.match(/\\d+/)[0])");
        assert_eq!(red.as_u64().expect("rgb(RED, ...)") > 128, bright, "{scheme} system, {chosen} chosen");
        assert_eq!(findings(&mut browser, FAINT), [""; 0], "{scheme} system, {chosen} chosen");
        keep(&mut browser, &format!("report-{scheme}-{chosen}.png"));
    }
    the_numbers_are_on_the_page(&mut browser, &report, folder.path());
    let narrow = "document.documentElement.scrollWidth <= innerWidth";
    browser.resize(390, 800);
    assert_eq!(browser.value(narrow), true, "the page does not scroll sideways on a phone");
    // There each part of a page of several groups is folded away, and names leave their charts room.
    open(&mut browser, folder.path(), &report, &json!([]));
    let parts = "[...document.querySelectorAll('.report > [id]')].map(({ tagName, open }) => `${tagName} ${open}`)";
    let parts = browser.value(parts);
    let parts = parts.as_array().expect("a list");
    assert!(parts.len() > 8 && parts.iter().all(|part| part == "DETAILS false"), "{parts:?}");
    browser.value("document.querySelector('#results').open = true");
    let wide = "(([frame, plot]) => plot.clientWidth > 0.5 * frame.clientWidth)(['.chart', '.u-over'].map((part) => document.querySelector(`#success-test-novel ${part}`)))";
    browser.wait_for("document.querySelector('#success-test-novel .u-over')");
    assert_eq!(browser.value(wide), true);
    keep(&mut browser, "report-narrow.png");
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
}

#[test]
fn of_one_seed_nothing_is_said_of_seeds_and_each_stage_has_its_figures() {
    let Some(mut browser) = Browser::start() else { return };
    let mut alone = run("disturb-two-stage", 1, (0.8, 0.5));
    let figures = |success: f64| {
        let named = |(name, mean): (&str, f64)| (name.to_owned(), mean);
        [("success", success), ("disturbance_m", 0.03), ("episode/return", 8.11)].map(named).into()
    };
    alone.stages = vec![figures(0.25), figures(0.6)];
    let report = Report::of(&[alone], &Options::default(), Vec::new()).expect("a sound run");
    let folder = tempfile::tempdir().expect("a temporary folder");
    open(&mut browser, folder.path(), &report, &json!([]));
    let of = |part: &str| format!("document.querySelector('{part}').innerText");
    // Of one run they stand beside its results, and nowhere else.
    let card = browser.value(&of(".report .card"));
    for said in
        ["disturb-two-stage-1", "training, stage", "25.0%", "60.0%", "disturbance per success (m)", "0.120", "0.050"]
    {
        assert!(card.as_str().is_some_and(|card| card.contains(said)), "{said}: {card}");
    }
    assert_eq!(browser.value("document.querySelector('#stages') === null"), true);
    // An interval has a line of its own beneath its figure, and is explained below.
    let figure = browser.value("document.querySelector('.report .figures dd').innerText.split('\\n').length");
    assert_eq!(figure, 2);
    assert!(card.as_str().is_some_and(|card| !card.contains("Wilson")), "{card}");
    assert_eq!(browser.value("document.querySelector('.report .grid + p').innerText.includes(\"Wilson's\")"), true);
    // All say one and the same return.
    // Its heading is the run's name; what the figures are is said, and a chart ends where nothing changes any more.
    assert_eq!(
        browser.value(
            "[document.querySelector('h1').textContent, document.querySelector('.figures [title]').title !== '']"
        ),
        json!(["disturb-two-stage-1", true])
    );
    let shown = "document.querySelector('[data-figure=\"episode/return\"] output').textContent";
    assert_eq!(browser.value(shown), "8.11 · newest tenth");
    let rate = "document.querySelector('[data-figure=\"time/frames_per_second\"] output').textContent";
    assert_eq!(browser.value(rate), "2,100 · mean");
    browser.resize(400, 800);
    assert_eq!(browser.value("document.documentElement.scrollWidth <= innerWidth"), true);
    assert_eq!(browser.value("document.querySelector('#differences')"), Value::Null);
    let results = browser.value(&of("#results"));
    let results = results.as_str().expect("text");
    assert!(!results.contains("IQM") && !results.contains("seeds"), "{results}");
    assert_eq!(browser.value(&of("#results thead th")), "run");
    let axis = "document.querySelector('#training .chart canvas') !== null";
    browser.wait_for(axis);
}

#[test]
fn runs_of_several_tasks_share_no_axis_and_no_table() {
    let Some(mut browser) = Browser::start() else { return };
    let mut other = run("point-nav-demo", 1, (0.8, 0.5));
    other.evaluations.clear();
    let runs = [run("disturb-two-stage", 1, (0.8, 0.5)), run("disturb-two-stage", 2, (0.8, 0.5)), other];
    let report = Report::of(&runs, &Options::default(), Vec::new()).expect("sound runs");
    let folder = tempfile::tempdir().expect("a temporary folder");
    open(&mut browser, folder.path(), &report, &json!([]));
    let titles = "[...document.querySelectorAll('[id^=training] h2')].map((one) => one.textContent)";
    assert_eq!(browser.value(titles), json!(["Learning curves, arm point nav", "Learning curves, point nav"]));
    let curves =
        "[...document.querySelectorAll('[data-figure=\"episode/return\"] .chart')].map(({ ariaLabel }) => ariaLabel)";
    let curves = browser.value(curves);
    let names = ["disturb-two-stage", "point-nav-demo-1"];
    for (at, name) in names.iter().enumerate() {
        let label = curves[at].as_str().expect("a chart");
        assert!(!label.contains(names[1 - at]), "{name}: {label}");
    }
    // On a narrow screen the curves of each task are folded away.
    browser.resize(400, 800);
    open(&mut browser, folder.path(), &report, &json!([]));
    assert_eq!(browser.value("document.querySelectorAll('details[id^=training]:not([open])').length"), 2);
    browser.resize(1280, 900);
    let empty = "for (const table of document.querySelectorAll('#results table')) \
        [...table.tHead.rows[0].cells].forEach((head, at) => { if ([...table.tBodies[0].rows].every((row) => !row.cells[at].textContent)) found.push(head.textContent); })";
    assert_eq!(findings(&mut browser, empty), [""; 0], "every column has a figure");
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
}

fn the_numbers_are_on_the_page(browser: &mut Browser, report: &Report, folder: &Path) {
    let group = &report.groups[0];
    let success = group.results[0].metrics["success"].mean;
    let interval = success.interval.expect("five seeds");
    let percent = |share: f64| format!("{:.1}", 100.0 * share);
    let cell = browser.value("document.querySelector('#results tbody td:nth-child(4)').innerText");
    let expected =
        format!("{}%\n{}\u{a0}–\u{a0}{}%", percent(success.point), percent(interval.low), percent(interval.high));
    assert_eq!(cell, expected.as_str());
    let chart = "#success-test-novel .save";
    let table = browser.download(&format!("{chart}:nth-child(2)"), folder, "sr-test-novel-objects.csv");
    let table = String::from_utf8(table).expect("text");
    let row = table.lines().find_map(|line| line.strip_prefix(&format!("{},", group.label))).expect("the first group");
    let numbers: Vec<f64> = row.split(',').filter_map(|number| number.parse().ok()).collect();
    assert_eq!(numbers, [success.point, interval.low, interval.high, 0.813], "and what the paper has");
    let picture = browser.download(chart, folder, "sr-test-novel-objects.png");
    let [width, height] = [16, 20].map(|at| u32::from_be_bytes(picture[at..at + 4].try_into().expect("a header")));
    assert!(picture.starts_with(b"\x89PNG") && width == 1440 && height > 500, "{width} × {height}");
    // A click on its name hides a group everywhere, and shows it again.
    let curves = "document.querySelector('#training .chart').ariaLabel.includes('disturb-two-stage')";
    for shown in [false, true] {
        browser.value("document.querySelector('.report > .legend button').click()");
        assert_eq!(browser.value(curves), shown);
    }
}

#[test]
fn a_page_says_what_is_missing_and_runs_no_script_of_its_data() {
    let hostile = "</script><script>document.title = 'taken'</script><img src=x onerror=\"document.title = 'taken'\">";
    let mut bare = run("demo", 1, (0.5, 0.5));
    (bare.name, bare.rollouts, bare.evaluations, bare.validation) = (hostile.to_owned(), vec![], vec![], vec![]);
    let report = Report::of(&[bare], &Options::default(), vec![hostile.to_owned()]).expect("a sound run");
    let page = view::page::report(&json!({ "report": report }).to_string(), "");
    assert!(page.contains("default-src 'none'") && !page.contains("'unsafe-inline'") && !page.contains(hostile));
    for outside in ["<script src", "<link", "<img", "@import", "url("] {
        assert!(!page.contains(outside), "the page reaches out by {outside}");
    }
    let Some(mut browser) = Browser::start() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    open(&mut browser, folder.path(), &report, &json!([]));
    let missing = browser.value("document.querySelector('#missing').textContent");
    for said in [
        "has been evaluated yet",
        "has trained a rollout",
        "[validation]",
        "--record all",
        "lambda-0",
        "Beside the paper",
    ] {
        assert!(missing.as_str().is_some_and(|missing| missing.contains(said)), "{said}: {missing}");
    }
    assert!(missing.as_str().is_some_and(|missing| missing.contains("stillroom eval RUN --record all")));
    // A table of the paper stands where a group is in one.
    assert_eq!(browser.value("document.querySelectorAll('tr.absent').length"), 0);
    let open = browser.value("[...document.querySelectorAll('details[open]')].map((one) => one.id)");
    assert_eq!(open, json!(["", "missing"]), "the notes, and what is missing where nothing is evaluated");
    assert_eq!(
        browser.value("[document.title, document.querySelectorAll('img').length]"),
        json!(["Stillroom report", 0])
    );
    // Of somebody's environments, by another name of the program; a picture that is missing is no matter of trust.
    let note = "`orchestrator replay RUN` makes films of it";
    let data = json!({ "report": report, "program": "orchestrator", "drawn": false, "labelled": false, "episodes": [], "undrawn": [note] });
    let path = folder.path().join("other.html");
    std::fs::write(&path, view::page::report(&data.to_string(), "")).expect("a writable folder");
    browser.open(&format!("file://{}", path.display()));
    browser.wait_for("document.querySelector('#missing')?.textContent.includes('(orchestrator eval RUN)')");
    assert_eq!(browser.value("document.querySelector('#missing code').textContent"), "orchestrator replay RUN");
    let missing = browser.value("document.querySelector('#missing').textContent");
    for other in ["--record all", "Prediction"] {
        assert!(missing.as_str().is_some_and(|missing| !missing.contains(other)), "{other}: {missing}");
    }
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
}
