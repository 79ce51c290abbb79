//! Who is answered.
//!
//! Other pages in the same browser can send requests to this machine, too. So an answer needs a `Host` that no foreign
//! name can lead to (an address, `localhost`, or this machine's name), a browser that does not say the request comes from
//! another site, and, where the server can be reached from elsewhere, the token of its address: in the cookie that the
//! page was given, as `Authorization: Bearer`, or behind `?token=` where a WebSocket is opened. For a WebSocket the
//! browser's `Origin` decides whether the page may ask.

use axum::extract::{Request, State};
use axum::http::header::{
    AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, COOKIE, HOST, LOCATION, ORIGIN, REFERRER_POLICY, SET_COOKIE,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// Only what this server itself sends is run, shown or asked.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Name of the cookie that the token is kept in.
const COOKIE_NAME: &str = "stillroom";

/// Where WebSockets are opened.
const SOCKETS: &str = "/foxglove";
/// Where Foxglove's own page is.
const FOXGLOVE: [&str; 2] = ["app.foxglove.dev", "studio.foxglove.dev"];

/// Whom to answer.
#[derive(Debug, Clone)]
pub struct Guard {
    /// What a request must show; none where only this machine can ask.
    pub token: Option<Arc<str>>,
    /// This machine's name.
    pub host_name: Arc<str>,
}

/// Lets a request through, or answers in its place; every answer carries the headers that hold the page together.
pub async fn check(State(guard): State<Guard>, request: Request, next: Next) -> Response {
    let mut answer = match guard.verdict(&request) {
        Verdict::Pass => next.run(request).await,
        Verdict::Welcome(cookie) => {
            (StatusCode::SEE_OTHER, [(SET_COOKIE, cookie), (LOCATION, "/".to_owned())]).into_response()
        }
        Verdict::Refuse(status, why) => (status, why).into_response(),
    };
    let headers = answer.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    answer
}

enum Verdict {
    Pass,
    /// The token is in the address: it goes into a cookie and out of the history.
    Welcome(String),
    Refuse(StatusCode, &'static str),
}

impl Guard {
    fn verdict(&self, request: &Request) -> Verdict {
        let headers = request.headers();
        if !self.is_own(headers) {
            return Verdict::Refuse(
                StatusCode::MISDIRECTED_REQUEST,
                "this server is not called that: use its address\n",
            );
        }
        let path = request.uri().path();
        let is_socket = path == SOCKETS || path.strip_prefix(SOCKETS).is_some_and(|rest| rest.starts_with('/'));
        let is_foreign = if is_socket {
            headers.get(ORIGIN).is_some_and(|origin| !may_open_sockets(origin, headers.get(HOST)))
        } else {
            headers.get("sec-fetch-site").is_some_and(|site| site == "cross-site" || site == "same-site") && path != "/"
        };
        if is_foreign {
            return Verdict::Refuse(StatusCode::FORBIDDEN, "another site's page may not ask this server\n");
        }
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            return Verdict::Refuse(StatusCode::METHOD_NOT_ALLOWED, "this server only shows: GET and HEAD\n");
        }
        let Some(token) = &self.token else { return Verdict::Pass };
        let of_query = |query: &str| query.split('&').find_map(|pair| pair.strip_prefix("token=")).map(str::to_owned);
        if request.uri().path() == "/"
            && let Some(shown) = request.uri().query().and_then(of_query)
            && same(&shown, token)
        {
            return Verdict::Welcome(format!("{COOKIE_NAME}={token}; Path=/; HttpOnly; SameSite=Lax"));
        }
        // Programs that open WebSockets keep no cookies, and cannot set a header.
        if is_socket && request.uri().query().and_then(of_query).is_some_and(|shown| same(&shown, token)) {
            return Verdict::Pass;
        }
        let kept = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut kept = kept.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
        if kept.any(|(name, value)| name == COOKIE_NAME && same(value, token)) {
            return Verdict::Pass;
        }
        // Programs such as Prometheus keep no cookies, and have a header for it.
        let shown = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        let shown = shown.and_then(|shown| shown.split_once(' '));
        if shown.is_some_and(|(kind, shown)| kind.eq_ignore_ascii_case("bearer") && same(shown.trim(), token)) {
            return Verdict::Pass;
        }
        Verdict::Refuse(
            StatusCode::UNAUTHORIZED,
            "open the whole address that `orchestrator view` printed: it holds a token\n",
        )
    }

    /// Whether the request calls this server by a name that only it can have.
    fn is_own(&self, headers: &HeaderMap) -> bool {
        let mut hosts = headers.get_all(HOST).iter();
        // Of two names nobody knows which one was meant.
        let (Some(host), None) = (hosts.next(), hosts.next()) else { return false };
        let Ok(host) = host.to_str() else { return false };
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split_once(']').map_or("", |(address, _)| address),
            None => host.rsplit_once(':').map_or(host, |(name, _)| name),
        };
        name.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || (!self.host_name.is_empty() && name.eq_ignore_ascii_case(&self.host_name))
    }
}

/// Whether a page from there may open WebSockets: our own, Foxglove's, and what is no page of the web, such as
/// Foxglove's program. Browsers let any page open them, and let no page name another origin than its own.
fn may_open_sockets(origin: &HeaderValue, host: Option<&HeaderValue>) -> bool {
    let Some((scheme, place)) = origin.to_str().ok().and_then(|origin| origin.split_once("://")) else { return false };
    match scheme {
        "http" | "https" => host.is_some_and(|host| host == place) || (scheme == "https" && FOXGLOVE.contains(&place)),
        _ => true,
    }
}

/// Compares in a time that does not tell how much agrees.
fn same(shown: &str, token: &str) -> bool {
    shown.len() == token.len() && shown.bytes().zip(token.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_that_nobody_else_can_point_here_are_ours() {
        let guard = Guard { token: None, host_name: "lab7".into() };
        let own = |host: &str| guard.is_own(&HeaderMap::from_iter([(HOST, HeaderValue::from_str(host).unwrap())]));
        for host in ["127.0.0.1:8080", "localhost", "LOCALHOST:9", "[::1]:8080", "10.0.0.7", "lab7:8080"] {
            assert!(own(host), "{host}");
        }
        for host in
            ["", "evil.example", "evil.example:8080", "127.0.0.1.evil.example", "[evil]:80", "lab7.evil.example"]
        {
            assert!(!own(host), "{host}");
        }
        assert!(!guard.is_own(&HeaderMap::new()));
    }

    #[test]
    fn no_foreign_page_opens_a_socket() {
        let host = HeaderValue::from_static("127.0.0.1:8765");
        let may = |origin: &'static str| may_open_sockets(&HeaderValue::from_static(origin), Some(&host));
        for own in ["http://127.0.0.1:8765", "https://app.foxglove.dev", "file://", "app://foxglove"] {
            assert!(may(own), "{own}");
        }
        for foreign in [
            "null",
            "",
            "https://evil.example",
            "http://127.0.0.1:1",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
        ] {
            assert!(!may(foreign), "{foreign}");
        }
    }

    #[test]
    fn a_token_is_right_or_wrong_as_a_whole() {
        assert!(same("abc", "abc"));
        assert!(!same("abd", "abc") && !same("ab", "abc") && !same("", "abc"));
    }
}
