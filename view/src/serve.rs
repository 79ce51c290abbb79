use crate::data::Runs;
use crate::routes::{Opening, router};
use crate::scene_renderer::SceneRenderer;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::future::Future;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;

const CONNECTIONS: usize = 512;
const HEAD_DEADLINE: Duration = Duration::from_secs(10);
/// How long a client may read nothing of what was sent to it: it would hold its place for ever.
const WRITE_DEADLINE: Duration = Duration::from_secs(12);
const HEAD_BYTES: usize = 32 << 10;

#[derive(Debug, Clone)]
pub struct Settings {
    pub actor: PathBuf,
    pub token: String,
    pub open: Vec<String>,
    pub compare: bool,
    pub play: Option<String>,
    /// Its steps a second.
    pub speed: Option<u32>,
    /// The name by which a shell finds the program.
    pub program: &'static str,
}

#[derive(Debug, thiserror::Error)]
#[error("cannot accept connections at {address}: {cause}")]
pub struct ServeError {
    address: SocketAddr,
    cause: std::io::Error,
}

pub async fn serve(
    listener: TcpListener,
    runs: Arc<dyn Runs>,
    settings: Settings,
    end: impl Future<Output = ()>,
) -> Result<(), ServeError> {
    let Settings { actor, token, open, compare, play, program, speed } = settings;
    let opening = Opening { runs: open, compare, play, program, speed, version: env!("CARGO_PKG_VERSION") };
    let router = router(runs, [actor.clone(), actor].map(SceneRenderer::new), token.into(), opening);
    let room = Arc::new(Semaphore::new(CONNECTIONS));
    tokio::pin!(end);
    loop {
        let accepted = tokio::select! {
            () = &mut end => return Ok(()),
            accepted = listener.accept() => accepted,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(cause) if is_of_one_connection(&cause) => continue,
            Err(cause) if is_of_the_moment(&cause) => {
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
            Err(cause) => {
                let address = listener.local_addr().unwrap_or_else(|_| SocketAddr::from(([0; 4], 0)));
                return Err(ServeError { address, cause });
            }
        };
        // Without room the client sees a closed connection and tries again.
        let Ok(place) = Arc::clone(&room).try_acquire_owned() else { continue };
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let _place = place;
            // Small answers must not wait for each other.
            let _ = stream.set_nodelay(true);
            let mut stream = TimeoutStream::new(stream);
            stream.set_write_timeout(Some(WRITE_DEADLINE));
            let connection = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD_DEADLINE)
                .max_buf_size(HEAD_BYTES)
                .serve_connection(TokioIo::new(Box::pin(stream)), service);
            // A client that hangs up or sends nonsense ends its own connection.
            if let Err(error) = connection.await {
                tracing::debug!("a connection ended: {error}");
            }
        });
    }
}

fn is_of_one_connection(cause: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset, Interrupted};
    matches!(cause.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset | Interrupted)
}

/// Whether there may be room again soon: no descriptor or memory is left.
fn is_of_the_moment(cause: &std::io::Error) -> bool {
    use rustix::io::Errno;
    let number = cause.raw_os_error();
    [Errno::MFILE, Errno::NFILE, Errno::NOBUFS, Errno::NOMEM].iter().any(|errno| Some(errno.raw_os_error()) == number)
}
