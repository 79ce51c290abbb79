//! A run live in Foxglove: a WebSocket with the topics of its recordings as they are recorded, and with what one of its
//! environments looks like at the moment, which is simulated again for it.
//!
//! The protocol is spoken by code of ours ([`protocol`]) and not by the crate `foxglove`, which listens on a port of its
//! own, without our guard and its token.

mod protocol;

use crate::answer::Refusal;
use crate::data::{EpisodeKey, Problem, Runs};
use crate::feed::{Feed, Recorded};
use crate::readings::Readings;
use crate::scene_renderer::SceneRenderer;
use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{
    CONNECTION, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL, SEC_WEBSOCKET_VERSION, UPGRADE,
};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::Response;
use futures_util::{SinkExt, StreamExt};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::show::{ShowAnswer, ShowRequest, ShownEpisode, ShownSolids};
use protocol::{Subscriptions, agreed};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message};

pub const CLIENTS: usize = 8;
/// How often recordings are looked at: a recorder flushes each second.
const EVERY: Duration = Duration::from_millis(500);
const PATIENCE: Duration = Duration::from_secs(20);
const ASKED_BYTES_MAX: usize = 256 << 10;

type Socket = WebSocketStream<TokioIo<Upgraded>>;
type Newest = (EpisodeKey, ReplaySetup, RecordedEpisode);

pub type EnvironmentKey = (u32, u32);

pub struct Sources {
    pub readings: Readings,
    pub scene_renderer: SceneRenderer,
    pub room: Arc<Semaphore>,
}

pub async fn connect(
    sources: Sources,
    run: Option<String>,
    watch: Option<EnvironmentKey>,
    mut request: Request,
) -> Result<Response, Refusal> {
    let refused = |what: &str| Refusal(StatusCode::BAD_REQUEST, what.to_owned());
    let (key, protocol) = asked(request.headers()).map_err(refused)?;
    let room = Arc::clone(&sources.room).try_acquire_owned();
    let place = room.map_err(|_| {
        let problem = format!("{CLIENTS} programs watch already: close one of them");
        Refusal(StatusCode::SERVICE_UNAVAILABLE, problem)
    })?;
    let (run, feed) = sources.readings.read(move |runs| begin(runs, run)).await?;
    let upgrade = request.extensions_mut().remove::<OnUpgrade>().ok_or_else(|| refused("no way to a WebSocket"))?;
    let session = Session {
        sources,
        run,
        feed: Some(feed),
        watch,
        subscriptions: Subscriptions::default(),
        sent: None,
        last: None,
    };
    tokio::spawn(session.serve(upgrade, place));
    let head: [(HeaderName, String); 4] = [
        (CONNECTION, "upgrade".to_owned()),
        (UPGRADE, "websocket".to_owned()),
        (SEC_WEBSOCKET_ACCEPT, derive_accept_key(key.as_bytes())),
        (SEC_WEBSOCKET_PROTOCOL, protocol.to_owned()),
    ];
    let mut answer = Response::builder().status(StatusCode::SWITCHING_PROTOCOLS);
    for (name, value) in head {
        answer = answer.header(name, value);
    }
    answer.body(Body::empty()).map_err(|_| refused("the key of the WebSocket is no text"))
}

fn asked(headers: &HeaderMap) -> Result<(String, &'static str), &'static str> {
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    if !text(UPGRADE).eq_ignore_ascii_case("websocket") || text(SEC_WEBSOCKET_VERSION) != "13" {
        return Err(
            "this is for Foxglove: open a connection (Foxglove WebSocket) to this address with ws:// before it",
        );
    }
    let key = text(SEC_WEBSOCKET_KEY);
    let protocol = agreed(text(SEC_WEBSOCKET_PROTOCOL));
    match protocol {
        Some(protocol) if !key.is_empty() => Ok((key.to_owned(), protocol)),
        _ => Err("this server speaks foxglove.sdk.v1 and foxglove.websocket.v1"),
    }
}

/// The run that is meant, and its feed: without a name one that goes on, else the newest.
fn begin(runs: &dyn Runs, run: Option<String>) -> Result<(String, Box<dyn Feed>), Problem> {
    let run = run.or_else(|| {
        let cards = runs.list();
        let goes_on = cards.iter().find(|card| card.state == "running" && !card.evaluation);
        goes_on.or(cards.first()).map(|card| card.id.clone())
    });
    let run = run.ok_or_else(|| Problem::NotThere("there is no run".to_owned()))?;
    let feed = runs.feed(&run)?;
    Ok((run, feed))
}

fn newest(runs: &dyn Runs, run: &str, place: Option<EnvironmentKey>) -> Result<Newest, Problem> {
    let first = || {
        let kitchens = runs.live(run).ok()?.kitchens;
        kitchens.iter().find_map(|kitchen| Some((kitchen.kitchen, *kitchen.environments.first()?)))
    };
    let nothing = || Problem::NotThere("nothing is recorded yet".to_owned());
    let (kitchen, environment) = place.or_else(first).ok_or_else(nothing)?;
    let key = runs.newest(run, kitchen, environment)?.ok_or_else(nothing)?;
    let (setup, episode) = runs.recorded(run, key)?;
    Ok((key, setup, episode))
}

struct Session {
    sources: Sources,
    run: String,
    feed: Option<Box<dyn Feed>>,
    watch: Option<EnvironmentKey>,
    subscriptions: Subscriptions,
    sent: Option<u32>,
    last: Option<LastMoment>,
}

/// The newest moment: its episode, the actions up to it, whether the room is in it, and what is there.
type LastMoment = (EpisodeKey, usize, bool, Box<ShownEpisode>, Box<ShownSolids>);

impl Session {
    async fn serve(mut self, upgrade: OnUpgrade, _place: OwnedSemaphorePermit) {
        let Ok(upgraded) = upgrade.await else { return };
        let config =
            WebSocketConfig::default().max_message_size(Some(ASKED_BYTES_MAX)).max_frame_size(Some(ASKED_BYTES_MAX));
        let socket = WebSocketStream::from_raw_socket(TokioIo::new(upgraded), Role::Server, Some(config)).await;
        // A client that hangs up ends its own session.
        if let Err(error) = self.talk(socket).await {
            tracing::debug!("a Foxglove session ended: {error}");
        }
    }

    async fn talk(&mut self, mut socket: Socket) -> Result<(), Error> {
        let greeting = Subscriptions::greeting(&format!("Stillroom: {}", self.run), &self.run);
        send(&mut socket, Message::text(greeting)).await?;
        let mut ticks = tokio::time::interval(EVERY);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut turn = 0_u64;
        loop {
            tokio::select! {
                said = socket.next() => match said {
                    Some(Ok(Message::Text(text))) => self.subscriptions.take(&text),
                    Some(Ok(Message::Close(_))) | None => return Ok(()),
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(error),
                },
                _ = ticks.tick() => {
                    // Each second: the room is simulated for it.
                    if !self.tell(&mut socket, turn.is_multiple_of(2)).await? {
                        return Ok(());
                    }
                    turn += 1;
                }
            }
        }
    }

    async fn tell(&mut self, socket: &mut Socket, with_moment: bool) -> Result<bool, Error> {
        let Some(mut feed) = self.feed.take() else { return Ok(false) };
        let read = self.sources.readings.read(move |_| {
            let recorded = feed.read();
            Ok((feed, recorded))
        });
        // Refused while too many wait: the feed is lost, and the client connects again.
        let Ok((feed, recorded)) = read.await else { return Ok(false) };
        let of_moment = feed.moment_topics();
        let topics = [feed.topics(), of_moment.clone()].concat();
        for offer in self.subscriptions.offer(&topics) {
            send(socket, Message::text(offer)).await?;
        }
        self.tell_all(socket, &recorded).await?;
        if with_moment && of_moment.iter().any(|topic| self.subscriptions.wants(topic)) {
            let moment = self.moment(&*feed).await.unwrap_or_else(|Refusal(_, problem)| {
                tracing::debug!("no moment for Foxglove: {problem}");
                Vec::new()
            });
            self.tell_all(socket, &moment).await?;
        }
        self.feed = Some(feed);
        Ok(true)
    }

    async fn tell_all(&self, socket: &mut Socket, recorded: &[Recorded]) -> Result<(), Error> {
        for message in recorded.iter().flat_map(|recorded| self.subscriptions.messages(recorded)) {
            send(socket, Message::binary(message)).await?;
        }
        Ok(())
    }

    async fn moment(&mut self, feed: &dyn Feed) -> Result<Vec<Recorded>, Refusal> {
        if self.subscriptions.has_newcomers() {
            self.sent = None;
        }
        let (run, place) = (self.run.clone(), self.watch);
        let (key, setup, episode) = self.sources.readings.read(move |runs| newest(runs, &run, place)).await?;
        // What is always the same is sent once; a run through many kitchens comes to others.
        let whole = self.sent != Some(key.kitchen);
        let actions = episode.actions.len();
        let is_last = |(last, count, with_room, ..): &(EpisodeKey, usize, bool, _, _)| {
            (*last, *count, *with_room) == (key, actions, whole)
        };
        if !self.last.as_ref().is_some_and(is_last) {
            let name = format!("foxglove/{}/{key}", self.run);
            let (shown, solids) = self.simulate(name, setup, episode, whole).await?;
            self.last = Some((key, actions, whole, shown, solids));
        }
        self.sent = Some(key.kitchen);
        Ok(self.last.as_ref().map_or_else(Vec::new, |(_, _, _, shown, solids)| feed.moment(shown, solids, whole)))
    }

    async fn simulate(
        &self,
        name: String,
        setup: ReplaySetup,
        episode: RecordedEpisode,
        fixed: bool,
    ) -> Result<(Box<ShownEpisode>, Box<ShownSolids>), Refusal> {
        let failed = |answer: ShowAnswer| match answer {
            ShowAnswer::Failed { problem } => Refusal(StatusCode::UNPROCESSABLE_ENTITY, problem),
            other => Refusal(StatusCode::INTERNAL_SERVER_ERROR, format!("another answer than asked for: {other:?}")),
        };
        let scene_renderer = &self.sources.scene_renderer;
        let open = ShowRequest::Open { name: name.clone(), setup, episode: Box::new(episode) };
        let shown = match scene_renderer.ask(open).await?.0 {
            ShowAnswer::Opened(shown) => shown,
            other => return Err(failed(other)),
        };
        let step = shown.moments.len().saturating_sub(1) as u32;
        match scene_renderer.ask(ShowRequest::Solids { name, step, fixed }).await?.0 {
            ShowAnswer::Solids(solids) => Ok((shown, solids)),
            other => Err(failed(other)),
        }
    }
}

async fn send(socket: &mut Socket, message: Message) -> Result<(), Error> {
    let sent = tokio::time::timeout(PATIENCE, socket.send(message)).await;
    sent.unwrap_or(Err(Error::ConnectionClosed))
}
