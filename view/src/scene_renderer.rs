//! `actor show` as a child: asked one thing at a time, started when it is needed and again when it died.
//!
//! It runs at a low priority: what is looked at must not slow what is trained.

use proto::exit::how;
use proto::show::{ShowAnswer, ShowRequest};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::{mpsc, oneshot};

const WAITING: usize = 32;
/// An answer takes well under a second, the first of a kitchen a few on a busy machine.
const DEADLINE: Duration = Duration::from_mins(2);
const ENDS: Duration = Duration::from_secs(1);
const IDLE: Duration = Duration::from_mins(10);
/// As the server: the lowest would leave a busy machine with a hundredth of a core for pictures that somebody waits for.
const NICENESS: i32 = 10;
const BYTES_MAX: u64 = 64 << 20;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TheatreError {
    #[error("too many pictures are waited for: try again")]
    Busy,
    #[error("the simulator cannot be used: {0}")]
    Broken(String),
    #[error("the simulator cannot be used: `actor show` {0}")]
    Ended(String),
}

type Answer = Result<(ShowAnswer, Vec<u8>), TheatreError>;

#[derive(Clone)]
pub struct SceneRenderer(mpsc::Sender<(ShowRequest, oneshot::Sender<Answer>)>);

impl SceneRenderer {
    pub fn new(program: PathBuf) -> Self {
        let (sender, receiver) = mpsc::channel(WAITING);
        tokio::spawn(work(program, receiver));
        Self(sender)
    }

    pub async fn ask(&self, request: ShowRequest) -> Answer {
        let (sender, receiver) = oneshot::channel();
        self.0.try_send((request, sender)).map_err(|_| TheatreError::Busy)?;
        receiver.await.unwrap_or_else(|_| Err(TheatreError::Broken("its keeper has ended".to_owned())))
    }
}

async fn work(program: PathBuf, mut requests: mpsc::Receiver<(ShowRequest, oneshot::Sender<Answer>)>) {
    let mut player: Option<Player> = None;
    loop {
        let (request, reply) = match tokio::time::timeout(IDLE, requests.recv()).await {
            Ok(Some(asked)) => asked,
            Ok(None) => return,
            Err(_) => {
                player = None;
                continue;
            }
        };
        if reply.is_closed() {
            continue;
        }
        let mut answer = answer_of(&mut player, &program, &request).await;
        if let Err(TheatreError::Ended(_)) = answer {
            // Another one is asked once more.
            answer = answer_of(&mut player, &program, &request).await;
        }
        // Nobody waits any more: the picture was drawn in vain.
        let _ = reply.send(answer);
    }
}

async fn answer_of(player: &mut Option<Player>, program: &PathBuf, request: &ShowRequest) -> Answer {
    let broken = |error: std::io::Error| TheatreError::Broken(error.to_string());
    let mut at_work = player.take().map_or_else(|| Player::start(program), Ok).map_err(broken)?;
    match tokio::time::timeout(DEADLINE, at_work.ask(request)).await {
        Ok(Ok(answer)) => {
            // Only one that answered as agreed is asked again.
            *player = Some(at_work);
            Ok(answer)
        }
        Ok(Err(error)) => match tokio::time::timeout(ENDS, at_work.child.wait()).await {
            Ok(Ok(status)) => Err(TheatreError::Ended(how(status))),
            _ => Err(broken(error)),
        },
        Err(_) => Err(TheatreError::Broken(format!("no answer within {} s", DEADLINE.as_secs()))),
    }
}

struct Player {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Player {
    fn start(program: &PathBuf) -> std::io::Result<Self> {
        let mut child = Command::new(program)
            .arg("show")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()?;
        if let Some(pid) = child.id().and_then(|pid| rustix::process::Pid::from_raw(pid.cast_signed())) {
            // Where it is refused it is as important as others, and right all the same.
            let _ = rustix::process::setpriority_process(Some(pid), NICENESS);
        }
        let missing = || std::io::Error::other("the child has no pipes");
        let input = child.stdin.take().ok_or_else(missing)?;
        let output = BufReader::new(child.stdout.take().ok_or_else(missing)?);
        Ok(Self { child, input, output })
    }

    async fn ask(&mut self, request: &ShowRequest) -> std::io::Result<(ShowAnswer, Vec<u8>)> {
        let mut line = serde_json::to_string(request)?;
        line.push('\n');
        self.input.write_all(line.as_bytes()).await?;
        self.input.flush().await?;
        let mut line = String::new();
        if self.output.read_line(&mut line).await? == 0 {
            return Err(std::io::Error::other("it has ended"));
        }
        let answer: ShowAnswer = serde_json::from_str(&line)?;
        let mut picture = Vec::new();
        if let ShowAnswer::Picture { bytes } = answer {
            if bytes > BYTES_MAX {
                return Err(std::io::Error::other("it announces a picture that is too large"));
            }
            picture.resize(bytes as usize, 0);
            self.output.read_exact(&mut picture).await?;
        }
        Ok((answer, picture))
    }
}
