//! Kitchens side by side: floor plan and robot's view of each, with what there is to say about it.

use crate::parallel::in_parallel;
use anyhow::{Context, Result, ensure};
use picture::{Canvas, Rgb, Views};
use proto::config::SimulationConfig;
use proto::kitchen::{KitchenId, Split};
use simulator::kitchen::Kitchen;
use simulator::scene_file;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

const PAPER: Rgb = [250, 250, 248];
const INK: Rgb = [34, 38, 44];
const FAINT: Rgb = [112, 118, 126];
const COLUMNS: usize = 5;
/// A narrower one cuts its words, pixels.
const CELL_LEAST: usize = 240;
const MARGIN: usize = 10;
const TITLE: usize = 26;
const HEAD: usize = 46;
const WIDTH_MIN: u32 = 320;
const WIDTH_MAX: u32 = 8192;

#[derive(Debug, Clone)]
pub struct SheetOptions {
    pub subjects: Vec<Subject>,
    /// Pixels; of few kitchens less than of many if it is not given.
    pub width: Option<u32>,
    pub out: PathBuf,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Subject {
    BuiltIn(KitchenId),
    /// A scene of a user's own: its TOML file.
    Scene(PathBuf),
}

impl Subject {
    pub fn load(&self) -> Result<Kitchen> {
        let simulation = SimulationConfig::default();
        match self {
            Self::BuiltIn(id) => Ok(Kitchen::build(*id, &simulation)?),
            Self::Scene(path) => {
                let id = KitchenId::scene(0).context("there is a first scene")?;
                Ok(scene_file::load(path, id, &simulation)?)
            }
        }
    }

    /// What it is called on the sheet: a kitchen's number, or the name of a scene's folder or file.
    fn name(&self) -> String {
        match self {
            Self::BuiltIn(id) => id.to_string(),
            Self::Scene(path) => scene_file::name_of(path),
        }
    }

    /// A word about where it belongs, and its colour.
    fn kind(&self) -> (&'static str, Rgb) {
        match self {
            Self::BuiltIn(id) => split(*id),
            Self::Scene(_) => ("scene", [104, 70, 140]),
        }
    }
}

/// `kitchen 7`, `scene studio`
impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if matches!(self, Self::BuiltIn(_)) { "kitchen" } else { "scene" };
        write!(f, "{kind} {}", self.name())
    }
}

pub fn sheet(options: &SheetOptions) -> Result<()> {
    ensure!(!options.subjects.is_empty(), "no kitchen was asked for");
    let width = options.width.unwrap_or((440 * options.subjects.len().min(COLUMNS) as u32).max(1100));
    ensure!((WIDTH_MIN..=WIDTH_MAX).contains(&width), "a sheet is {WIDTH_MIN} to {WIDTH_MAX} pixels wide, not {width}");
    let width = width as usize;
    let columns = options.subjects.len().min(COLUMNS).min(width / CELL_LEAST).max(1);
    let rows = options.subjects.len().div_ceil(columns);
    let cell = (width - MARGIN) / columns - MARGIN;
    let side = cell / 2;
    let pairs = draw_all(&options.subjects, side)?;

    let height = HEAD + rows * (TITLE + side + MARGIN) + MARGIN;
    let mut canvas = Canvas::new(width, height, PAPER);
    let title = match options.subjects.as_slice() {
        [scene @ Subject::Scene(_)] => scene.to_string(),
        _ => "Stillroom kitchens".to_owned(),
    };
    let end = canvas.text(&title, 26.0, MARGIN as f32, 31.0, INK);
    let legend = format!(
        "each: floor plan cut at 1.4 m, and the robot's (orange) view, of which it gets depth; {} things",
        pairs.iter().map(|(_, _, things)| *things).sum::<usize>()
    );
    // On a narrow sheet it would be cut.
    if end + 18.0 + 8.0 * legend.len() as f32 <= width as f32 {
        canvas.text(&legend, 17.0, end + 18.0, 31.0, FAINT);
    }
    for (index, (subject, (views, plan, things))) in options.subjects.iter().zip(&pairs).enumerate() {
        let x = MARGIN + index % columns * (cell + MARGIN);
        let y = HEAD + index / columns * (TITLE + side + MARGIN);
        let (word, colour) = subject.kind();
        canvas.fill(x, y + 3, 4, TITLE - 8, colour);
        let end = canvas.text(&subject.name(), 21.0, x as f32 + 10.0, y as f32 + 18.0, INK);
        let end = canvas.text(word, 17.0, end + 9.0, y as f32 + 18.0, colour);
        canvas.text(&format!("{plan}{things} things"), 17.0, end + 9.0, y as f32 + 18.0, FAINT);
        canvas.place(&views.plan, x, y + TITLE);
        canvas.place(&views.robot, x + side, y + TITLE);
    }
    canvas.write_png(&options.out)?;
    let bytes = std::fs::metadata(&options.out).map_or(0, |file| file.len());
    println!(
        "{}: {}, {width} × {height} pixels, {} kB",
        options.out.display(),
        if let [subject] = options.subjects.as_slice() {
            subject.to_string()
        } else {
            format!("{} kitchens", pairs.len())
        },
        bytes.div_ceil(1000)
    );
    Ok(())
}

/// Pictures, plan and number of things of a kitchen.
type Drawn = (Views, String, usize);

/// How often something is said while many kitchens are drawn, each for seconds.
const SAID_EVERY: usize = 5;

/// Pictures, plan and number of things of each kitchen, in order, on all cores.
fn draw_all(subjects: &[Subject], side: usize) -> Result<Vec<Drawn>> {
    let drawn = AtomicUsize::new(0);
    let draw = |index: usize| -> Result<Drawn> {
        let subject: &Subject = &subjects[index];
        let kitchen = subject.load()?;
        let views =
            Views::of(&kitchen, side, PAPER).with_context(|| format!("{subject}: the kitchen has no free floor"))?;
        let plan = kitchen.plan().map_or_else(String::new, |plan| format!("{}, ", plan.name()));
        let (number, all) = (drawn.fetch_add(1, Ordering::Relaxed) + 1, subjects.len());
        if number.is_multiple_of(SAID_EVERY) && number < all {
            eprintln!("{number} of {all} kitchens are drawn");
        }
        Ok((views, plan, kitchen.thing_count()))
    };
    if subjects.len() > SAID_EVERY {
        eprintln!("{} kitchens are built and drawn, each for some seconds", subjects.len());
    }
    in_parallel(subjects.len(), draw).into_iter().collect()
}

fn split(id: KitchenId) -> (&'static str, Rgb) {
    match id.split() {
        _ if id.is_procedural() => ("procedural", [120, 92, 24]),
        Split::Train => ("train", [40, 108, 72]),
        Split::Validation => ("validation", [36, 92, 168]),
        Split::Test => ("test", [170, 56, 44]),
    }
}
