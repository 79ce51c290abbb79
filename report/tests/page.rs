//! The page in a headless browser: what fits a screen, which colours things have, what can be taken away.
//!
//! Where no Chromium is installed nothing is tested; `.ci/run` says so.

mod study;

use report::{Made, Options};
use serde_json::Value;
use study::study;
use system_tests::Browser;

/// What a script in the page finds wrong: a list of sentences.
fn findings(browser: &mut Browser, script: &str) -> Vec<String> {
    let found = browser.value(&format!("(() => {{ const found = []; {script}; return found; }})()"));
    found.as_array().expect("a list").iter().map(|one| one.as_str().unwrap_or("?").to_owned()).collect()
}

/// What is wider than what it is in, but for what is folded away.
const TOO_WIDE: &str = "for (const box of document.querySelectorAll('.scroll')) \
    if (box.scrollWidth > box.clientWidth) found.push(`${box.innerText.slice(0, 60)}: ${box.scrollWidth} of ${box.clientWidth}`); \
    if (document.documentElement.scrollWidth > innerWidth) found.push(`the page: ${document.documentElement.scrollWidth}`)";

/// Names of groups with more than one colour in all legends and tables, or of one colour and dashes with another.
const COLOURS: &str = "const seen = {}; \
    for (const span of document.querySelectorAll('.legend span, td:first-child')) { \
      const [line, mark] = [span.querySelector('svg polyline'), span.querySelector('svg polygon')]; \
      if (!line) continue; \
      const ink = getComputedStyle(line).stroke; \
      if (ink !== getComputedStyle(mark).fill) found.push(`${span.textContent}: marker and line differ`); \
      const look = `${ink} ${line.getAttribute('stroke-dasharray')}`; \
      const name = [...span.childNodes].filter((node) => node.nodeType === 3).map((node) => node.data).join('').trim(); \
      (seen[name] ??= new Set()).add(look); } \
    for (const [name, looks] of Object.entries(seen)) if (looks.size !== 1) found.push(`${name}: ${[...looks]}`); \
    const all = Object.values(seen).flatMap((looks) => [...looks]); \
    if (new Set(all).size !== all.length) found.push('two groups look alike'); \
    if (all.length < 9) found.push(`only ${all.length} groups are shown`)";

/// Text that is hard to read before what it is on: a contrast of less than 4.5.
const FAINT: &str = "const channels = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map(Number); \
    const luminance = (colour) => { const [r, g, b] = channels(colour).map((value) => { const part = value / 255; \
      return part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const behind = (element) => { for (let at = element; at; at = at.parentElement) { \
      const colour = getComputedStyle(at).backgroundColor; if (!/, 0\\)$|transparent/.test(colour)) return colour; } return 'rgb(255, 255, 255)'; }; \
    const against = (ink, paper, what) => { const [a, b] = [luminance(ink), luminance(paper)].sort((x, y) => y - x); \
      const contrast = (a + 0.05) / (b + 0.05); if (contrast < 4.5) found.push(`${what}: ${contrast.toFixed(1)}, ${ink} on ${paper}`); }; \
    for (const element of document.querySelectorAll('p, li, td, th, h1, h2, h3, a, summary, figcaption, label, small')) \
      if (element.innerText?.trim()) against(getComputedStyle(element).color, behind(element), element.innerText.slice(0, 30)); \
    for (const words of document.querySelectorAll('figure .panels svg text')) \
      against(getComputedStyle(words).fill, getComputedStyle(words.closest('svg').querySelector('rect')).fill, words.textContent)";

fn paper(browser: &mut Browser) -> u64 {
    let colour = browser.value("getComputedStyle(document.body).backgroundColor");
    let text = colour.as_str().expect("a colour").trim_start_matches("rgb(").to_owned();
    text.split(',').next().and_then(|red| red.parse().ok()).expect("rgb(RED, ...)")
}

#[test]
fn the_page_fits_a_screen_has_one_colour_a_group_and_gives_its_figures_away() {
    let Some(mut browser) = Browser::start() else {
        eprintln!("no Chromium on the PATH: the page was not tested");
        return;
    };
    let made = Made::of(&study(), &Options::default(), Vec::new()).expect("sound runs");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("report.html");
    std::fs::write(&path, made.page("Made for a test.")).expect("a writable folder");
    browser.keep_downloads_in(folder.path());
    browser.open(&format!("file://{}", path.display()));
    browser.wait_for("document.readyState === 'complete' && document.querySelector('figure')");
    if let Some(kept) = std::env::var_os("STILLROOM_SCREENSHOTS") {
        let picture = browser.screenshot();
        std::fs::write(std::path::Path::new(&kept).join("report.png"), picture).expect("a folder of pictures");
    }

    browser.resize(1280, 900);
    assert_eq!(findings(&mut browser, TOO_WIDE), [""; 0], "nothing scrolls on a screen of 1280 pixels");
    browser.value("document.querySelectorAll('details').forEach((one) => { one.open = true; })");
    assert_eq!(findings(&mut browser, TOO_WIDE), [""; 0], "nor does what was folded away");
    let mut themes = Vec::new();
    for (scheme, chosen, bright) in
        [("light", "system", true), ("dark", "system", false), ("dark", "light", true), ("light", "dark", false)]
    {
        browser.scheme(scheme);
        browser.value(&format!("document.querySelector('#theme-{chosen}').click()"));
        assert_eq!(paper(&mut browser) > 128, bright, "{scheme} system, {chosen} chosen");
        assert_eq!(findings(&mut browser, COLOURS), [""; 0], "{scheme} system, {chosen} chosen");
        assert_eq!(findings(&mut browser, FAINT), [""; 0], "{scheme} system, {chosen} chosen");
        themes.push(browser.value("getComputedStyle(document.querySelector('.legend polyline')).stroke"));
    }
    assert!(themes[0] == themes[2] && themes[1] == themes[3] && themes[0] != themes[1], "{themes:?}");

    for figure in made.figures.all() {
        let name = &figure.name;
        let mut take = |ending: &str| {
            let selector = format!("figure[id='{name}'] a[download$='.{ending}']");
            browser.download(&selector, folder.path(), &format!("{name}.{ending}"))
        };
        assert_eq!(String::from_utf8_lossy(&take("svg")), figure.svg(), "{name}");
        assert_eq!(String::from_utf8_lossy(&take("csv")), figure.csv(), "{name}");
    }
    the_data_is_what_is_drawn(&made);
    let parsed = browser.value(
        "new DOMParser().parseFromString(decodeURIComponent(document.querySelector('#learning-1 a[download]').href.split(',').slice(1).join(',')), \
         'image/svg+xml').documentElement.tagName",
    );
    assert_eq!(parsed, Value::from("svg"));
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
}

/// The numbers of `report.json` are in the tables that can be taken away.
fn the_data_is_what_is_drawn(made: &Made) {
    let figure = made.figures.all().find(|figure| figure.name == "results-test-novel").expect("a figure");
    let table = figure.csv();
    let group = &made.report.groups[0];
    let success = group.results[0].success.iqm;
    let interval = success.interval.expect("five seeds");
    let start = format!("success rate,{},interquartile mean,", group.label);
    let row = table.lines().find_map(|line| line.strip_prefix(&start)).unwrap_or_else(|| panic!("{start} in\n{table}"));
    let numbers: Vec<f64> = row.split(',').filter_map(|number| number.parse().ok()).collect();
    for (number, expected) in numbers.iter().zip([success.point, interval.low, interval.high]) {
        assert!((number - expected).abs() < 1e-8, "{number} is not {expected}");
    }
    assert_eq!(numbers.len(), 4, "and what the paper has");
}
