//! gRPC by tonic: each actor has one bidirectional stream, over TCP of this machine.

use crate::end::{ActorEnd, LearnerEnd, Place, actions};
use anyhow::{Context, Result, anyhow};
use bytes::Bytes;
use service::exchange_client::ExchangeClient;
use service::exchange_server::{Exchange, ExchangeServer};
use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::mpsc;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio_stream::wrappers::{TcpListenerStream, UnboundedReceiverStream};
use tokio_stream::{Stream, StreamExt};
use tonic::transport::{Endpoint, Server};
use tonic::{Request, Response, Status, Streaming};

/// Largest message, and the window of a stream: more than a half.
const LARGEST: usize = 64 << 20;

#[derive(Clone, PartialEq, prost::Message)]
struct Observations {
    #[prost(uint32, tag = "1")]
    actor: u32,
    #[prost(uint32, tag = "2")]
    half: u32,
    #[prost(bytes = "bytes", tag = "3")]
    frames: Bytes,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Actions {
    #[prost(uint32, tag = "1")]
    half: u32,
    #[prost(bytes = "bytes", tag = "2")]
    actions: Bytes,
}

mod service {
    #![allow(clippy::all, clippy::pedantic, missing_docs, unreachable_pub, private_interfaces)]
    include!(concat!(env!("OUT_DIR"), "/bench.Exchange.rs"));
}

type Answers = tokio::sync::mpsc::UnboundedSender<Result<Actions, Status>>;

/// Passes on what arrives, with the way back.
struct Service(mpsc::Sender<(Observations, Answers)>);

#[tonic::async_trait]
impl Exchange for Service {
    type ExchangeStream = Pin<Box<dyn Stream<Item = Result<Actions, Status>> + Send>>;

    async fn exchange(
        &self,
        request: Request<Streaming<Observations>>,
    ) -> Result<Response<Self::ExchangeStream>, Status> {
        let (arrived, mut stream) = (self.0.clone(), request.into_inner());
        let (answers, outgoing) = tokio::sync::mpsc::unbounded_channel();
        tokio::spawn(async move {
            while let Some(Ok(observations)) = stream.next().await {
                if arrived.send((observations, answers.clone())).is_err() {
                    return;
                }
            }
        });
        Ok(Response::new(Box::pin(UnboundedReceiverStream::new(outgoing))))
    }
}

pub struct Learner {
    place: Place,
    arrived: mpsc::Receiver<(Observations, Answers)>,
    held: [BTreeMap<u32, Bytes>; 2],
    actors: BTreeMap<u32, Answers>,
    _runtime: Runtime,
}

impl Learner {
    pub fn open(place: &Place) -> Result<Self> {
        let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let (sender, arrived) = mpsc::channel();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0"))?;
        std::fs::write(place.folder().join("port"), listener.local_addr()?.port().to_string())?;
        let service = ExchangeServer::new(Service(sender)).max_decoding_message_size(LARGEST);
        let server = Server::builder()
            .initial_stream_window_size(LARGEST as u32)
            .initial_connection_window_size(LARGEST as u32)
            .tcp_nodelay(true)
            .add_service(service)
            .serve_with_incoming(TcpListenerStream::new(listener));
        runtime.spawn(server);
        Ok(Self { place: place.clone(), arrived, held: Default::default(), actors: BTreeMap::new(), _runtime: runtime })
    }
}

impl LearnerEnd for Learner {
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()> {
        while self.held[half as usize].len() < self.place.actors as usize {
            let (Observations { actor, half, frames }, answers) =
                self.arrived.recv().context("the server has ended")?;
            self.actors.entry(actor).or_insert(answers);
            self.held[half as usize].insert(actor, frames);
        }
        self.held[half as usize].iter().for_each(|(&actor, frames)| each(actor, frames));
        Ok(())
    }

    fn answer(&mut self, half: u32, action: u8) -> Result<()> {
        self.held[half as usize].clear();
        let actions = Bytes::from(actions(&self.place, action));
        for answers in self.actors.values() {
            let sent = answers.send(Ok(Actions { half, actions: actions.clone() }));
            sent.map_err(|_| anyhow!("an actor has gone"))?;
        }
        Ok(())
    }
}

pub struct Actor {
    number: u32,
    bytes: usize,
    runtime: Runtime,
    outgoing: tokio::sync::mpsc::UnboundedSender<Observations>,
    answers: Streaming<Actions>,
}

impl Actor {
    pub fn open(place: &Place, number: u32) -> Result<Self> {
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let port = std::fs::read_to_string(place.folder().join("port")).context("the server has no port")?;
        let endpoint = Endpoint::from_shared(format!("http://127.0.0.1:{port}"))?
            .initial_stream_window_size(LARGEST as u32)
            .initial_connection_window_size(LARGEST as u32)
            .tcp_nodelay(true);
        let (outgoing, stream) = tokio::sync::mpsc::unbounded_channel();
        let answers = runtime.block_on(async {
            let client = ExchangeClient::new(endpoint.connect().await?);
            let mut client = client.max_decoding_message_size(LARGEST).max_encoding_message_size(LARGEST);
            anyhow::Ok(client.exchange(UnboundedReceiverStream::new(stream)).await?.into_inner())
        })?;
        Ok(Self { number, bytes: place.bytes(), runtime, outgoing, answers })
    }
}

impl ActorEnd for Actor {
    fn send(&mut self, half: u32, pattern: u8) -> Result<()> {
        let frames = Bytes::from(vec![pattern; self.bytes]);
        let sent = self.outgoing.send(Observations { actor: self.number, half, frames });
        sent.map_err(|_| anyhow!("the server has gone"))
    }

    fn wait(&mut self) -> Result<(u32, u8)> {
        let answer = self.runtime.block_on(self.answers.message())?.context("the server has ended the stream")?;
        Ok((answer.half, *answer.actions.first().context("an answer without actions")?))
    }
}
