use crate::answer::{Refusal, json, text};
use crate::data::{EpisodeKey, EpisodeQuery, Made, Problem, Recorded, Runs, Source};
use crate::guard;
use crate::page::{ASSETS, again, report_policy};
use crate::readings::Readings;
use crate::run_feeds::RunFeeds;
use crate::scene_renderer::SceneRenderer;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{StatusCode, Uri};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Router, middleware};
use futures_util::stream::{Stream, unfold};
use proto::show::{ShowAnswer, ShowOrbit, ShowRequest, ShowView, ShownEpisode};
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::sync::Arc;

#[derive(Clone)]
struct Server {
    readings: Readings,
    run_feeds: RunFeeds,
    /// For what a visitor looks at, and for what may come later: that holds up nothing.
    scene_renderers: [SceneRenderer; 2],
    opening: Arc<Opening>,
}

#[derive(Debug, Clone, Default, Serialize)]
pub struct Opening {
    pub runs: Vec<String>,
    pub compare: bool,
    /// The policy that plays, in words.
    pub play: Option<String>,
    /// Its steps a second.
    pub speed: Option<u32>,
    pub program: &'static str,
    pub version: &'static str,
}

pub fn router(runs: Arc<dyn Runs>, scene_renderers: [SceneRenderer; 2], token: Arc<str>, opening: Opening) -> Router {
    let server = Server {
        run_feeds: RunFeeds::new(Arc::clone(&runs)),
        readings: Readings::of(runs),
        scene_renderers,
        opening: Arc::new(opening),
    };
    let mut router = Router::new()
        .route("/api/opening", get(opening_page))
        .route("/api/runs", get(list))
        .route("/api/runs/{run}", get(live))
        .route("/api/runs/{run}/live", get(follow))
        .route("/api/runs/{run}/curves", get(curves))
        .route("/api/runs/{run}/report", get(report))
        .route("/api/runs/{run}/suite", get(suite))
        .route("/api/runs/{run}/episodes", get(episodes))
        .route("/api/runs/{run}/pairs/{other}", get(pairs))
        .route("/api/runs/{run}/episodes/{key}", get(episode))
        .route("/api/runs/{run}/episodes/{key}/film", get(film))
        .route("/api/runs/{run}/episodes/{key}/picture", get(picture))
        .route("/api/runs/{run}/newest/{kitchen}/{environment}", get(newest))
        .fallback(|uri: Uri| async move { Refusal(StatusCode::NOT_FOUND, format!("nothing is at {}", uri.path())) });
    for asset in ASSETS {
        let answer = move || async move { ([(CONTENT_TYPE, asset.kind)], asset.content).into_response() };
        router = router.route(asset.path, get(answer));
    }
    router.with_state(server).layer(middleware::from_fn_with_state(token, guard::check))
}

impl Server {
    async fn answer<T, F>(&self, ask: F) -> Result<Response, Refusal>
    where
        T: Serialize + Send + 'static,
        F: FnOnce(&dyn Runs) -> Result<T, Problem> + Send + 'static,
    {
        self.readings.read(move |runs| ask(runs).map(|value| text(&value))).await.map(json)
    }

    async fn open(&self, run: &str, key: EpisodeKey, later: bool) -> Result<(ShowAnswer, Made), Refusal> {
        let owned = run.to_owned();
        let Recorded { source, made } = self.readings.read(move |runs| runs.recorded(&owned, key)).await?;
        let (setup, episode) = match source {
            Source::Actions { setup, episode } => (setup, episode),
            Source::Steps(shown) => return Ok((ShowAnswer::Opened(shown), made)),
        };
        let request = ShowRequest::Open { name: name_of(run, key), setup, episode };
        let (answer, _) = self.scene_renderers[usize::from(later)].ask(request).await?;
        match answer {
            ShowAnswer::Failed { problem } => Err(Refusal(StatusCode::UNPROCESSABLE_ENTITY, problem)),
            answer => Ok((answer, made)),
        }
    }
}

/// What the page is sent of an episode.
#[derive(Serialize)]
struct Opened {
    #[serde(flatten)]
    shown: Box<ShownEpisode>,
    #[serde(flatten)]
    made: Made,
}

async fn opening_page(State(server): State<Server>) -> Response {
    json(text(&*server.opening))
}

async fn list(State(server): State<Server>) -> Result<Response, Refusal> {
    server.answer(|runs| Ok(runs.list())).await
}

async fn live(State(server): State<Server>, Path(run): Path<String>) -> Result<Response, Refusal> {
    server.answer(move |runs| runs.live(&run)).await
}

async fn follow(
    State(server): State<Server>,
    Path(run): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Refusal> {
    let asked = run.clone();
    // An unknown run is an error now, not a stream of them.
    server.readings.read(move |runs| runs.live(&asked).map(drop)).await?;
    let receiver = server.run_feeds.follow(&run);
    let events = unfold((receiver, true), |(mut receiver, first)| async move {
        let ready = first && !receiver.borrow_and_update().is_empty();
        if !ready {
            receiver.changed().await.ok()?;
        }
        let text = Arc::clone(&receiver.borrow_and_update());
        Some((Ok(Event::default().data(&*text)), (receiver, false)))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::default()))
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct CurvesQuery {
    edition: u64,
    known: usize,
}

async fn curves(
    State(server): State<Server>,
    Path(run): Path<String>,
    query: Result<Query<CurvesQuery>, QueryRejection>,
) -> Result<Response, Refusal> {
    let CurvesQuery { edition, known } = understood(query)?;
    server.answer(move |runs| runs.curves(&run, edition, known)).await
}

async fn episodes(
    State(server): State<Server>,
    Path(run): Path<String>,
    query: Result<Query<EpisodeQuery>, QueryRejection>,
) -> Result<Response, Refusal> {
    let query = understood(query)?;
    server.answer(move |runs| runs.episodes(&run, &query)).await
}

async fn pairs(State(server): State<Server>, Path((run, other)): Path<(String, String)>) -> Result<Response, Refusal> {
    server.answer(move |runs| runs.pairs([&run, &other])).await
}

async fn report(State(server): State<Server>, Path(run): Path<String>) -> Result<Response, Refusal> {
    let page = server.readings.read(move |runs| runs.report(&run)).await?;
    let page = again(&page).unwrap_or(page);
    let kind = "text/html; charset=utf-8".to_owned();
    Ok(([(CONTENT_TYPE, kind), (CONTENT_SECURITY_POLICY, report_policy())], page).into_response())
}

async fn suite(State(server): State<Server>, Path(run): Path<String>) -> Result<Response, Refusal> {
    server.answer(move |runs| runs.suite(&run)).await
}

async fn film(
    State(server): State<Server>,
    Path((run, key)): Path<(String, String)>,
) -> Result<impl IntoResponse, Refusal> {
    let key: EpisodeKey = key.parse()?;
    let film = server.readings.read(move |runs| runs.film(&run, key)).await?;
    Ok(([(CONTENT_TYPE, film.kind)], film.bytes))
}

fn understood<T>(query: Result<Query<T>, QueryRejection>) -> Result<T, Refusal> {
    query.map(|Query(query)| query).map_err(|rejection| Refusal(StatusCode::BAD_REQUEST, rejection.body_text()))
}

async fn newest(
    State(server): State<Server>,
    Path((run, kitchen, environment)): Path<(String, u32, u32)>,
) -> Result<Response, Refusal> {
    server.answer(move |runs| runs.newest(&run, kitchen, environment)).await
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct OpenQuery {
    #[serde(default)]
    later: bool,
}

async fn episode(
    State(server): State<Server>,
    Path((run, key)): Path<(String, String)>,
    query: Result<Query<OpenQuery>, QueryRejection>,
) -> Result<Response, Refusal> {
    let OpenQuery { later } = understood(query)?;
    match server.open(&run, key.parse()?, later).await? {
        (ShowAnswer::Opened(shown), made) => Ok(json(text(&Opened { shown, made }))),
        _ => Err(unasked()),
    }
}

fn unasked() -> Refusal {
    Refusal(StatusCode::INTERNAL_SERVER_ERROR, "the simulator gave another answer than was asked for".to_owned())
}

fn name_of(run: &str, key: EpisodeKey) -> String {
    format!("{run}/{key}")
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PictureQuery {
    view: String,
    step: u32,
    width: u32,
    height: Option<u32>,
    #[serde(default)]
    fine: bool,
    #[serde(default)]
    dark: bool,
    #[serde(default)]
    later: bool,
    /// Of a free camera: middle and radius (metres), yaw and pitch (radians).
    #[serde(default)]
    x: f32,
    #[serde(default)]
    y: f32,
    #[serde(default)]
    z: f32,
    #[serde(default = "one")]
    radius: f32,
    #[serde(default)]
    yaw: f32,
    #[serde(default)]
    pitch: f32,
    /// Number of steps that the page knows, of an episode that goes on: another number is another picture.
    #[serde(default, rename = "of")]
    _of: u32,
}

fn one() -> f32 {
    1.0
}

impl PictureQuery {
    fn view(&self) -> Result<ShowView, Refusal> {
        if ![self.x, self.y, self.z, self.radius, self.yaw, self.pitch].into_iter().all(f32::is_finite) {
            return Err(Refusal(StatusCode::BAD_REQUEST, "a camera's place is of finite numbers".to_owned()));
        }
        match self.view.as_str() {
            "orbit" => Ok(ShowView::Orbit(ShowOrbit {
                centre_m: [self.x, self.y, self.z],
                radius_m: self.radius,
                yaw_rad: self.yaw,
                pitch_rad: self.pitch,
            })),
            "depth" => Ok(ShowView::Depth),
            "plan" => Ok(ShowView::Plan),
            _ => Err(Refusal(StatusCode::BAD_REQUEST, "a view is orbit, depth or plan".to_owned())),
        }
    }
}

async fn picture(
    State(server): State<Server>,
    Path((run, key)): Path<(String, String)>,
    query: Result<Query<PictureQuery>, QueryRejection>,
) -> Result<Response, Refusal> {
    let query = understood(query)?;
    let key: EpisodeKey = key.parse()?;
    let view = query.view()?;
    let (width, height) = (query.width, query.height.unwrap_or(query.width));
    let PictureQuery { step, fine, dark, later, .. } = query;
    let request = ShowRequest::Draw { name: name_of(&run, key), step, view, width, height, fine, dark };
    let ask = || async { server.scene_renderers[usize::from(later)].ask(request.clone()).await };
    let (mut answer, mut bytes) = ask().await?;
    if answer == ShowAnswer::NotOpen {
        // The simulator was started again, or has opened many others since.
        server.open(&run, key, later).await?;
        (answer, bytes) = ask().await?;
    }
    match answer {
        ShowAnswer::Picture { .. } => {
            Ok(([(CONTENT_TYPE, "image/png"), (CACHE_CONTROL, "private, max-age=600")], bytes).into_response())
        }
        ShowAnswer::Failed { problem } => Err(Refusal(StatusCode::UNPROCESSABLE_ENTITY, problem)),
        ShowAnswer::NotOpen => {
            Err(Refusal(StatusCode::NOT_FOUND, "no pictures are drawn of environments of your own".to_owned()))
        }
        ShowAnswer::Opened(_) => Err(unasked()),
    }
}
