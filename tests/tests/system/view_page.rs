//! The page of `orchestrator view` as a person uses it, in a headless browser: a run's curves move, an episode is
//! opened, stepped through and looked at from elsewhere; by mouse, by keys alone, on a narrow screen, light and dark.
//!
//! Where no Chromium is installed nothing is tested; `.ci/run` says so. `STILLROOM_SCREENSHOTS=FOLDER` keeps pictures.

use serde_json::Value;
use system_tests::{Browser, Viewer, Workshop, finish, start};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;
/// Budget of the run at first, and the one that it goes on to while its curves are looked at.
const FRAMES: [u64; 2] = [1200, 1600];

/// Keeps a picture of the page, if they are wanted.
fn keep(browser: &mut Browser, name: &str) {
    if let Some(folder) = std::env::var_os("STILLROOM_SCREENSHOTS") {
        let picture = browser.screenshot();
        std::fs::write(std::path::Path::new(&folder).join(format!("{name}.png")), picture)
            .expect("a folder of pictures");
    }
}

/// Colours in a canvas, and a number that changes with its pixels.
fn pixels(browser: &mut Browser, selector: &str) -> (u64, u64) {
    let value = browser.value(&format!(
        "(() => {{ const canvas = document.querySelector({selector:?}); \
         const {{ data }} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
         const seen = new Set(); let sum = 0; \
         for (let at = 0; at < data.length; at += 4) {{ const colour = data[at] << 16 | data[at + 1] << 8 | data[at + 2]; \
         seen.add(colour); sum = (sum * 31 + colour) % 2147483647; }} return [seen.size, sum]; }})()"
    ));
    let number = |at: usize| value[at].as_u64().expect("a number");
    (number(0), number(1))
}

/// Presses Tab until an element that fits has the keyboard.
fn tab_to(browser: &mut Browser, selector: &str) {
    for _ in 0..120 {
        if browser.value(&format!("document.activeElement?.matches({selector:?})")) == true {
            return;
        }
        browser.press("Tab");
    }
    panic!("the keyboard never gets to {selector}");
}

fn text(browser: &mut Browser, selector: &str) -> String {
    let value = browser.value(&format!("document.querySelector({selector:?})?.textContent"));
    value.as_str().unwrap_or_default().to_owned()
}

#[test]
fn a_run_is_watched_and_an_episode_is_looked_at() {
    let Some(mut browser) = Browser::start() else { return };
    let workshop = Workshop::new();
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    let viewer = Viewer::start(&workshop, &[]);
    browser.open(&format!("http://{}/", viewer.address));
    browser.wait_for("document.body.innerText.includes('run it again and open the one that it prints')");
    assert!(
        browser.complaints.drain(..).all(|complaint| complaint.contains("401")),
        "the page is for who has the token"
    );
    // The address of a viewer is put in where a page of it is open; it is reloaded without the token.
    for address in [viewer.page(), format!("http://{}/", viewer.address)] {
        browser.open(&address);
        browser.wait_for("document.body.innerText.includes('No run yet')");
        assert_eq!(browser.value("location.href.includes('token') || document.cookie !== ''"), false);
    }
    browser.wait_for("document.body.innerText.includes('No run yet')");
    let child = start(workshop.up("runs/watched", ACTORS, ENVIRONMENTS, FRAMES[0]));
    browser.wait_for("document.querySelector('a[href=\"#/run/watched\"]')");
    keep(&mut browser, "list");
    finish(child).result();
    curves_move(&mut browser, &workshop);
    browser.wait_for("document.querySelector('.state.complete')");
    // Of a run at rest: its newest episodes, and nothing that is of the moment.
    browser.wait_for("document.querySelectorAll('.tiles canvas.room[data-step]').length > 0");
    assert_eq!(browser.value("document.body.innerText.includes('What they see now')"), false);
    assert_eq!(
        browser.value("[...document.querySelectorAll('summary')].some((one) => one.innerText.includes('have ended'))"),
        true
    );
    // What its figures are, and how it is evaluated, which it is not yet.
    let said = "['What SR, SRwoD', 'not evaluated yet:'].every((text) => document.querySelector('main').innerText.includes(text))";
    browser.wait_for(said);
    assert_eq!(browser.value("document.querySelectorAll('main th[title^=\"Success rate\"]').length > 0"), true);
    keep(&mut browser, "run");
    thumbnails_are_tried_again(&mut browser);
    what_is_waited_for_is_said(&mut browser);
    an_episode_is_looked_at(&mut browser);
    only_keys(&mut browser);
    narrow_and_dark(&mut browser);
    two_are_beside_one_another(&mut browser, &workshop);
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    assert!(viewer.stop());
}

/// However fast the machine: the run has come to its end when its curves are looked at, and then it goes on.
fn curves_move(browser: &mut Browser, workshop: &Workshop) {
    browser.value("document.querySelector('a[href=\"#/run/watched\"]').click()");
    let points = "Number(document.querySelector('[data-figure=\"time/frames_per_second\"]')?.dataset.points ?? 0)";
    let trained = || workshop.run("runs/watched").metrics().len();
    let before = trained();
    browser.wait_for(&format!("{points} === {before}"));
    browser.wait_for("document.querySelector('section[aria-label=Progress]').innerText.includes('of 1,200')");
    let drawn = pixels(browser, "[data-figure='time/frames_per_second'] canvas");
    assert!(drawn.0 > 5, "a curve, a grid and words: {} colours", drawn.0);
    let longer = FRAMES[1].to_string();
    workshop.call(&["resume", "runs/watched", "--frames", &longer]).result();
    assert!(trained() > before, "it went on");
    browser.wait_for(&format!("{points} === {}", trained()));
    assert_ne!(pixels(browser, "[data-figure='time/frames_per_second'] canvas"), drawn, "the curve moved");
    browser.wait_for("document.querySelector('section[aria-label=Progress]').innerText.includes('of 1,600')");
}

/// Failures that were overcome are not counted when others come.
fn thumbnails_are_tried_again(browser: &mut Browser) {
    browser.value(
        "(async () => { \
           const own = { fetch, setTimeout, EventSource }; \
           const planted = { own, failing: 4, root: document.createElement('div'), leaving: new AbortController() }; \
           const refusal = () => Promise.resolve(new Response('{}', { status: 500 })); \
           const ask = (path, options) => \
             (path.includes('/episodes?') && planted.failing-- > 0 ? refusal() : own.fetch.call(window, path, options)); \
           Object.assign(window, { planted, fetch: ask, \
             setTimeout: (work, wait) => own.setTimeout.call(window, work, wait === 5000 ? 20 : wait), \
             EventSource: class { constructor() { planted.events = this; } close() {} } }); \
           const { showRun } = await import('/run.js'); \
           await showRun(planted.root, 'watched', planted.leaving.signal); \
         })()",
    );
    // A reader that is late is no news where nothing is missing.
    browser.value("planted.events.onmessage({ data: JSON.stringify({ error: 'a planted delay', waits: true }) }); 0");
    assert_eq!(browser.value("planted.root.textContent.includes('a planted delay')"), false);
    let kept = "planted.root.querySelectorAll('.tiles figure').length === 6";
    assert_eq!(browser.value(kept), true, "what comes late has its room");
    browser.wait_for("planted.failing < 0 && planted.root.querySelector('.tiles canvas.room[data-step]')");
    browser.value(
        "(async () => { \
           const { json } = await import('/dom.js'); \
           const live = await json('/api/runs/watched'); \
           planted.failing = 4; \
           planted.events.onmessage({ data: JSON.stringify({ ...live, rollouts: live.rollouts + 1 }) }); \
         })()",
    );
    browser.wait_for("planted.failing < 0 || planted.root.querySelector('.tiles .notice')");
    assert_eq!(browser.value("planted.root.querySelector('.tiles .notice') === null"), true);
    browser.value("planted.leaving.abort(); Object.assign(window, planted.own); 0");
}

/// Of an episode that takes long to be simulated, and then of its first picture.
fn what_is_waited_for_is_said(browser: &mut Browser) {
    browser.value(
        "(async () => { \
           const { json } = await import('/dom.js'); \
           const { rows } = await json('/api/runs/watched/episodes?recorded=true&limit=1'); \
           const own = fetch; \
           const planted = { own, root: document.createElement('div'), leaving: new AbortController(), names: [] }; \
           const held = new Promise((resolve) => { planted.go = resolve; }); \
           const ask = (path, options) => String(path).includes('/picture') ? new Promise(() => {}) \
             : held.then(() => own.call(window, path, options)); \
           Object.assign(window, { planted, fetch: ask }); \
           const { showEpisode } = await import('/episode.js'); \
           const { signal } = planted.leaving; \
           const named = (name) => planted.names.push(name); \
           showEpisode(planted.root, 'watched', rows[0].key, new URLSearchParams(), signal, named); \
         })()",
    );
    browser.wait_for("planted.root.textContent.includes('simulated again … 2 s')");
    browser.value("planted.go()");
    browser.wait_for("planted.root.querySelector('.picture')?.textContent.includes('The room is being drawn … 1 s')");
    // The page has a title at once, and a name when the episode is known.
    let names = "planted.names.length === 2 && /^kitchen \\d+, environment \\d+, episode \\d+$/.test(planted.names[1])";
    assert_eq!(browser.value(names), true);
    // The room, what the robot sees, and the floor plan say that they are not there yet.
    assert_eq!(browser.value("planted.root.querySelectorAll('.waits > .busy').length"), 3);
    browser.value("planted.leaving.abort(); window.fetch = planted.own; 0");
}

fn an_episode_is_looked_at(browser: &mut Browser) {
    browser.value("[...document.querySelectorAll('a')].find((link) => link.textContent === 'Episodes').click()");
    browser.wait_for("document.querySelector('table.episodes tr.link')");
    // The longest first: there is something to step through.
    for _ in 0..2 {
        browser.wait_for("document.querySelector('th[data-column=length] button')");
        if browser.value("document.querySelector('th[data-column=length]').ariaSort") != "descending" {
            browser.value("document.querySelector('th[data-column=length] button').click()");
        }
        browser.wait_for("document.querySelector('th[data-column=length]').ariaSort === 'descending'");
    }
    keep(browser, "episodes");
    let named = "[...document.querySelectorAll('table.episodes tr.link td.number a')].every(({ ariaLabel, textContent }) => \
        ariaLabel.startsWith(`episode ${textContent}, `) && ariaLabel.includes('kitchen ') && ariaLabel.includes(': '))";
    assert_eq!(browser.value(named), true, "links say which episode they open");
    browser.wait_for("Number(document.querySelector('table.episodes tbody tr td:nth-child(6)')?.textContent) > 5");
    browser.wait_for("document.querySelector('table.episodes canvas[data-step]')");
    let columns = "document.querySelectorAll('table.episodes thead th').length";
    let few = browser.value(columns);
    browser.value("document.querySelector('.filters input[type=checkbox]').click()");
    browser.wait_for(&format!("{columns} > {few}"));
    browser.value("document.querySelector('table.episodes tbody tr a').click()");
    browser.wait_for("document.querySelector('canvas.orbit')?.dataset.fine === '0'");
    browser.wait_for("document.querySelector('canvas.depth')?.dataset.step === '0'");
    assert!(text(browser, "main").contains("states are as recorded"));
    let room = pixels(browser, "canvas.orbit");
    assert!(room.0 > 100, "a room has more than {} colours", room.0);
    let depth = pixels(browser, "canvas.depth");
    assert!(depth.0 > 20, "a depth picture has more than {} colours", depth.0);

    // To the end by the keyboard: other pictures, other words.
    browser.press("End");
    let last = browser.value("document.querySelector('input[type=range]').max");
    let last = last.as_str().expect("a number").to_owned();
    browser.wait_for(&format!("document.querySelector('canvas.depth').dataset.step === '{last}'"));
    browser.wait_for(&format!("document.querySelector('canvas.orbit').dataset.fine === '{last}'"));
    assert_ne!(pixels(browser, "canvas.depth").1, depth.1, "the robot sees something else");
    browser.wait_for(&format!("document.body.innerText.includes('step {last}')"));
    let room = pixels(browser, "canvas.orbit");
    keep(browser, "episode");
    what_a_step_is_said_to_be(browser);
    // What stands above the pictures of its film.
    let caption = browser.value(
        "(async () => { const { caption } = await import('/film.js'); const outcome = 'time-limit'; \
           return caption({ key: '3-0-17', last: 9, episode: { number: 41, target: 'Mug', outcome } }, 12); })()",
    );
    assert_eq!(caption, "Kitchen 3, episode 41: Mug · time limit");

    // A finger has buttons for single steps.
    browser.value("document.querySelector('[aria-label=\"A step back\"]').click()");
    browser.wait_for("(({ value, max }) => Number(value) < Number(max))(document.querySelector('input[type=range]'))");
    browser.value("document.querySelector('[aria-label=\"A step on\"]').click()");
    browser.wait_for(&format!("document.querySelector('canvas.orbit').dataset.fine === '{last}'"));

    // The camera is turned by the mouse.
    browser.value("delete document.querySelector('canvas.orbit').dataset.fine");
    browser.drag("canvas.orbit", (120.0, 30.0));
    browser.wait_for(&format!("document.querySelector('canvas.orbit').dataset.fine === '{last}'"));
    let turned = pixels(browser, "canvas.orbit").1;
    assert_ne!(turned, room.1, "the camera was turned");
    // Two fingers that part go nearer.
    browser.value("delete document.querySelector('canvas.orbit').dataset.fine");
    browser.value(
        "(() => { const room = document.querySelector('canvas.orbit'); room.setPointerCapture = () => {}; \
         const finger = (kind, pointerId, clientX) => \
           room.dispatchEvent(new PointerEvent(kind, { pointerId, clientX, clientY: 300 })); \
         finger('pointerdown', 1, 300); finger('pointerdown', 2, 340); finger('pointermove', 2, 440); \
         finger('pointerup', 1, 300); finger('pointerup', 2, 440); })()",
    );
    browser.wait_for(&format!("document.querySelector('canvas.orbit').dataset.fine === '{last}'"));
    assert_ne!(pixels(browser, "canvas.orbit").1, turned, "the camera went nearer");
    // Nothing of an episode has to be scrolled to before it can be played.
    let play = "document.querySelector('.player button').getBoundingClientRect().bottom";
    browser.resize(1280, 800);
    assert!(browser.value(play).as_f64().is_some_and(|bottom| bottom <= 800.0), "Play is on the screen");
    assert!(text(browser, ".legend").contains("reward r"), "the strip has a legend");
    browser.resize(1280, 900);
    browser.wait_for("document.querySelector('.plan svg .robot') && document.querySelector('.plan svg .path')");
    // Its long side lies across.
    let lies = "(({ clientWidth, clientHeight }) => clientWidth >= clientHeight)(document.querySelector('.plan'))";
    assert_eq!(browser.value(lies), true);
    // Around the room it is as dark as the page.
    let corner = "document.querySelector('.plan canvas').getContext('2d').getImageData(0, 0, 1, 1).data[0]";
    browser.wait_for(&format!("{corner} > 200"));
    browser.scheme("dark");
    browser.wait_for(&format!("{corner} < 60"));
    browser.scheme("light");
}

fn what_a_step_is_said_to_be(browser: &mut Browser) {
    // The keys are one click away, and how far the robot's view reaches is said.
    browser.value("document.querySelector('details.keys summary').click()");
    browser.wait_for("[...document.querySelectorAll('kbd')].some((key) => key.checkVisibility() && key.textContent === 'shift arrows')");
    browser.wait_for(
        "/^0\\sm\\s+\\d+\\.\\d m or more$/.test(document.querySelector('.swatch.depths').parentElement.textContent)",
    );
    // What moved most has its name, also where nothing is violet.
    let named = "(async () => { const { Stage } = await import('/stage.js'); const table = { moved: document.createElement('div'), episode: { things: [] } }; \
        Stage.prototype.displaced.call(table, { moved: [], nearly: ['CoffeeMachine', 0.004], channels: { disturbance_m: [0.012] } }); return table.moved.innerText; })()";
    let named = browser.value(named);
    assert!(
        named.as_str().is_some_and(|text| text.contains("CoffeeMachine") && text.contains("others, less than")),
        "{named}"
    );
    names_cover_nothing(browser);
}

/// What was displaced most is named above the film, and beside it in the room: not over target, goal, robot or another name.
fn names_cover_nothing(browser: &mut Browser) {
    let named = browser.value(
        "(async () => { const [{ deeds }, { OrbitView }] = await Promise.all([import('/film.js'), import('/stage.js')]); \
           const things = [{ category: 'Mug' }, { category: 'Apple' }, { category: 'Fork' }]; \
           const moved = [[0, 0.02, [9, 1, 0]], [1, 0.118, [0.4, 1, 0]], [2, 0.05, [0.42, 1.02, 0]]]; \
           const channels = { target_position_m: [0.4, 1.05, 0], goal_position_m: [0.3, 1.1, 0], \
             base_position_m: [0, 0, 0], wrist_position_m: [0.35, 1.05, 0] }; \
           const episode = { things, goal_tolerance_m: 0.1, moments: [{ moved, channels }] }; \
           const names = document.createElement('div'); \
           const camera = { yaw_rad: 0, pitch_rad: 0, radius_m: 1, centre_m: [0, 1, 0] }; \
           const view = { __proto__: OrbitView.prototype, stage: { episode }, names, camera }; \
           view.name(0); \
           const said = () => ({ noted: [], measured: null }); \
           const [drawn, ...spans] = names.children; \
           const boxes = spans.map(({ style, textContent }) => { \
             const [left, top] = [6.4 * parseFloat(style.left), 4.8 * parseFloat(style.top)]; \
             return [left, top, left + 8 * textContent.length, top + 20]; }); \
           const apart = ([a, b, c, d], [e, f, g, h]) => a >= g || e >= c || b >= h || f >= d; \
           const others = [...view.taken(0, [640, 480]), ...boxes]; \
           const free = boxes.every((box) => others.every((other) => other === box || apart(box, other))); \
           const [x, y] = ['x1', 'y1'].map((name) => Math.round(drawn.firstChild.getAttribute(name))); \
           return [deeds({ episode, last: 0, said }, 0), spans.map(({ textContent }) => textContent), others.length > 8, free, x, y]; })()",
    );
    let names = ["Apple 0.12\u{a0}m", "Fork 0.05\u{a0}m"];
    assert_eq!(named, serde_json::json!(["step 0 of 0 · Apple moved 0.12 m", names, true, true, 438, 240]));
}

/// From the top of the page to an episode's third step without a mouse.
fn only_keys(browser: &mut Browser) {
    browser.value("location.hash = '#/run/watched/episodes'");
    browser.wait_for("document.querySelector('table.episodes tbody tr.link a')");
    browser.value("document.activeElement.blur()");
    tab_to(browser, "table.episodes tbody tr.link a");
    browser.press("Enter");
    browser.wait_for("document.querySelector('canvas.orbit')?.dataset.step === '0'");
    tab_to(browser, "canvas.orbit");
    browser.wait_for("document.querySelector('canvas.orbit').dataset.fine === '0'");
    let before = pixels(browser, "canvas.orbit").1;
    browser.value("delete document.querySelector('canvas.orbit').dataset.fine");
    browser.press("ArrowLeft");
    browser.wait_for("document.querySelector('canvas.orbit').dataset.fine === '0'");
    assert_ne!(pixels(browser, "canvas.orbit").1, before, "an arrow key turns the camera");
    tab_to(browser, "input[type=range]");
    browser.press("ArrowRight");
    browser.wait_for("document.querySelector('canvas.depth').dataset.step === '1'");
    // To the next episode of the table, and back.
    let place = "location.hash.split('?')[0]";
    browser.wait_for("document.querySelector('a[rel=next]')");
    let first = browser.value(place);
    browser.press("n");
    browser.wait_for(&format!("{place} !== {first} && document.querySelector('a[rel=prev]')"));
    browser.press("p");
    browser.wait_for(&format!("{place} === {first}"));
}

fn two_are_beside_one_another(browser: &mut Browser, workshop: &Workshop) {
    let copied = std::process::Command::new("cp")
        .args(["-r".as_ref(), workshop.path("runs/watched").as_os_str(), workshop.path("runs/copied").as_os_str()])
        .status();
    assert!(copied.is_ok_and(|status| status.success()), "cp");
    browser.value("location.hash = '#/?all'");
    browser.wait_for("document.querySelector('a[href=\"#/run/copied\"]')");
    // A column's head sorts, also by keys, and a reload keeps that.
    browser.value("document.activeElement.blur()");
    // What its figures are, and of which episodes.
    browser.wait_for("document.querySelector('th[data-column=SR]').title.startsWith('Success rate')");
    browser.wait_for("document.querySelector('main').innerText.includes('of an evaluation: over all its episodes')");
    for (order, first) in [("descending", "watched"), ("ascending", "copied")] {
        tab_to(browser, "th[data-column=run] button");
        browser.press("Enter");
        let sorted = format!("document.querySelector('th[data-column=run]').ariaSort === '{order}'");
        let at_top = format!("document.querySelector('tbody a').textContent === '{first}'");
        browser.wait_for(&format!("{sorted} && {at_top}"));
        browser.value("window.isOld = true; setTimeout(() => location.reload()); 0");
        browser.wait_for(&format!("!window.isOld && {sorted} && {at_top}"));
    }
    // A text leaves the runs that have it.
    let filter = |text: &str| {
        format!(
            "((box) => {{ box.value = '{text}'; box.dispatchEvent(new Event('input')); }})(document.querySelector('.chooser input[type=text]'))"
        )
    };
    let left = "[...document.querySelectorAll('.runs tbody a')].map((one) => one.textContent).join()";
    for (text, names) in [("Copied", "copied"), ("", "copied,watched")] {
        browser.value(&filter(text));
        assert_eq!(browser.value(left), names);
    }
    browser.value("location.hash = '#/run/watched+copied'");
    browser.wait_for("document.querySelectorAll('table[aria-label=\"The runs\"] tbody tr').length === 2");
    browser.wait_for("document.querySelector('[data-figure]')");
    // Nothing is there that only one of them has.
    assert_eq!(browser.value("document.querySelector('section[aria-label=Progress]') === null"), true);
    keep(browser, "two");
    browser.resize(390, 800);
    browser.value("location.hash = '#/compare/watched/copied'");
    browser.wait_for("document.querySelector('#difference')?.innerText.includes('All their actions are the same.')");
    let width = browser.value("document.documentElement.scrollWidth");
    assert!(width.as_u64().is_some_and(|width| width <= 390), "{width} pixels wide on a screen of 390");
    browser.wait_for("document.querySelectorAll('.twins canvas.orbit[data-fine]').length === 2");
    keep(browser, "compared");
    browser.resize(1280, 900);
}

fn narrow_and_dark(browser: &mut Browser) {
    let paper = "getComputedStyle(document.body).backgroundColor";
    for (scheme, bright) in [("light", true), ("dark", false)] {
        browser.scheme(scheme);
        browser.resize(390, 800);
        for (page, said) in
            [("#/?all", "disturbance"), ("#/run/watched", "disturbance"), ("#/run/watched/episodes", " steps")]
        {
            browser.value(&format!("location.hash = {page:?}"));
            browser.wait_for("document.querySelector('main table tbody tr, main figure')");
            // What has no column there is said elsewhere.
            browser.wait_for(&format!("document.querySelector('main').innerText.includes({said:?})"));
            let width = browser.value("document.documentElement.scrollWidth");
            assert!(
                width.as_u64().is_some_and(|width| width <= 390),
                "{page} is {width} pixels wide on a screen of 390"
            );
            let folded = "[...document.querySelectorAll('.fold')].every((one) => one.scrollWidth <= one.parentElement.clientWidth)";
            assert_eq!(browser.value(folded), true, "no table of {page} is cut");
        }
        let sorts = "((select) => select.checkVisibility() && ['+kitchen', '-length'].every((name) => \
            [...select.options].some(({ value }) => value === name)))(document.querySelector('.orders select'))";
        assert_eq!(browser.value(sorts), true, "what has no column there sorts, too");
        keep(browser, &format!("narrow-{scheme}"));
        browser.resize(1280, 900);
        browser.value("location.hash = '#/run/watched'");
        browser.wait_for("document.querySelector('[data-figure]')");
        browser.wait_for("document.querySelectorAll('.tiles canvas[data-step]').length > 0");
        keep(browser, &format!("run-{scheme}"));
        let colour = browser.value(paper);
        let red: Option<u8> =
            colour.as_str().and_then(|text| text.trim_start_matches("rgb(").split(',').next()?.parse().ok());
        assert_eq!(red.map(|red| red > 128), Some(bright), "{scheme}: {colour}");
    }
    let title: Value = browser.value("document.title");
    assert_eq!(title, "watched · Stillroom");
}
