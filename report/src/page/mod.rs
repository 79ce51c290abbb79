//! The report as one HTML page that needs nothing but itself.

mod comparison;
mod figure;
mod results;
mod runs;
mod table;

use crate::chart::theme_rules;
use crate::report::{Made, Report};
use crate::study::Origin;
use figure::drawn;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use results::NOT_EVALUATED;

const STYLE: &str = include_str!("style.css");

/// Sections of the page, in its order: one's own results come first.
#[derive(Debug, Clone, Copy)]
enum Section {
    Results,
    Paper,
    Learning,
    Optimisation,
    Validation,
    Disturbance,
    Episodes,
    Sweep,
    Prediction,
    Actions,
    Runs,
}

impl Section {
    const ALL: [Self; 11] = [
        Self::Results,
        Self::Paper,
        Self::Learning,
        Self::Optimisation,
        Self::Validation,
        Self::Disturbance,
        Self::Episodes,
        Self::Sweep,
        Self::Prediction,
        Self::Actions,
        Self::Runs,
    ];

    /// Anchor and heading.
    fn head(self) -> (&'static str, &'static str) {
        match self {
            Self::Results => ("groups", "Results"),
            Self::Paper => ("paper", "Beside the paper"),
            Self::Learning => ("training", "Learning curves"),
            Self::Optimisation => ("optimisation", "Optimisation"),
            Self::Validation => ("validation", "Validation during training"),
            Self::Disturbance => ("disturbance", "Success and disturbance"),
            Self::Episodes => ("episode", "One episode, before and after stage II"),
            Self::Sweep => ("sweep", "λ_disturb"),
            Self::Prediction => ("prediction", "Disturbance prediction"),
            Self::Actions => ("actions", "Actions by step"),
            Self::Runs => ("runs", "Runs and evaluations"),
        }
    }

    fn body(self, Made { report, figures }: &Made) -> Markup {
        match self {
            Self::Results => results::section(report, figures),
            Self::Paper => comparison::section(report),
            Self::Learning => {
                let otherwise = "None of these runs has trained a rollout (metrics.jsonl is empty).";
                drawn(&figures.learning, of_training(report, otherwise))
            }
            Self::Optimisation => {
                let otherwise = "None of these runs has noted an update (metrics.jsonl is empty).";
                drawn(&figures.optimisation, of_training(report, otherwise))
            }
            Self::Validation => {
                let otherwise =
                    "None of these runs was evaluated during training (the table [validation] of its configuration).";
                drawn(&figures.validation, of_training(report, otherwise))
            }
            Self::Disturbance => drawn(&figures.disturbance, NOT_EVALUATED),
            Self::Episodes => drawn(
                &figures.episodes,
                "No run here has recorded evaluations on the same episodes of weights from before stage II and from after \
                 it. A run keeps the checkpoint at each stage's end: orchestrator eval \
                 RUN/checkpoints/rollout-NUMBER.json --record all, and orchestrator eval RUN --record all.",
            ),
            Self::Sweep => drawn(
                &figures.sweep,
                "No two of these groups differ in λ_disturb alone and are evaluated on the same episodes. The presets \
                 lambda-0, lambda-1, lambda-5, ..., lambda-25 are the paper's sweep.",
            ),
            Self::Prediction => {
                let otherwise =
                    "None of these runs trained the auxiliary task disturb, whose focal loss these curves are about.";
                html! {
                    (drawn(&figures.prediction, of_training(report, otherwise)))
                    @if let Some(evaluated) = results::prediction(report) { (evaluated) }
                }
            }
            Self::Actions => drawn(&figures.actions, NOT_EVALUATED),
            Self::Runs => runs::section(report),
        }
    }
}

impl Made {
    /// The page. `made`: when it was made, and by which program.
    pub fn page(&self, made: &str) -> String {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width";
                    meta name="color-scheme" content="light dark";
                    title { "Stillroom report" }
                    style {
                        (PreEscaped(STYLE))
                        (PreEscaped(format!("@supports (color: light-dark(#000, #fff)) {{\n{}}}\n", theme_rules())))
                    }
                }
                body {
                    header {
                        h1 { "Stillroom report" }
                        (theme())
                    }
                    p { (made) }
                    nav {
                        @for (anchor, heading) in Section::ALL.map(Section::head) {
                            a href={ "#" (anchor) } { (heading) } " "
                        }
                    }
                    @for sentence in &self.report.episodes { p.episodes { (sentence) } }
                    @if !self.report.notes.is_empty() {
                        h3 { "Before you trust these figures" }
                        ul { @for note in &self.report.notes { li { (note) } } }
                    }
                    @for section in Section::ALL {
                        @let (anchor, heading) = section.head();
                        h2 id=(anchor) { (heading) }
                        (section.body(self))
                    }
                }
            }
        };
        page.into_string()
    }
}

/// Light or dark: as the system, unless the reader chooses. The style sheet looks at what is chosen, so that the page
/// needs no script.
fn theme() -> Markup {
    html! {
        fieldset.theme {
            legend { "Colours" }
            @for (value, text) in [("system", "as the system"), ("light", "light"), ("dark", "dark")] {
                label {
                    input type="radio" name="theme" id={ "theme-" (value) } value=(value) checked[value == "system"];
                    " " (text)
                }
            }
        }
    }
}

/// Why there is no figure about training. Where evaluations of a run are there and the run is not, its training is not
/// known, which differs from a run that has trained nothing.
fn of_training<'a>(report: &Report, otherwise: &'a str) -> &'a str {
    let mut runs = report.groups.iter().flat_map(|group| &group.runs);
    if runs.any(|run| matches!(run.state, Origin::NotGiven | Origin::Unknown)) {
        "Evaluations stand here without the runs that trained their weights; what was noted in training lies in a run's \
         own folder: name that folder, too."
    } else {
        otherwise
    }
}
