//! Who is answered.
//!
//! Every user of a machine can connect to 127.0.0.1, an end of a tunnel included, and every page in a browser can send
//! requests there. So all but the page's own files needs the viewer's token: as `Authorization: Bearer`, or as `?token=`
//! from what can set no header. There is no cookie: browsers send those to every port of a host,
//! where another user may listen, and for pages of other sites.

use crate::page::ASSETS;
use axum::extract::{Request, State};
use axum::http::header::{
    AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, REFERRER_POLICY, WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

/// Only what this server itself sends is run, shown or asked. A report has a policy of its own.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
                      media-src blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const REFUSAL: &str = "this viewer answers only with its token: open the whole address that `stillroom view` printed, \
                       or run it again and open the one that it prints\n";

pub async fn check(State(token): State<Arc<str>>, request: Request, next: Next) -> Response {
    let mut answer = if may_pass(&request, &token) {
        next.run(request).await
    } else {
        (StatusCode::UNAUTHORIZED, [(WWW_AUTHENTICATE, "Bearer")], REFUSAL).into_response()
    };
    let headers = answer.headers_mut();
    for (name, value) in [
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static(POLICY));
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    answer
}

fn may_pass(request: &Request, token: &str) -> bool {
    let header = request.headers().get(AUTHORIZATION).and_then(|value| value.to_str().ok()?.split_once(' '));
    let header = header.filter(|(kind, _)| kind.eq_ignore_ascii_case("bearer")).map(|(_, shown)| shown.trim());
    let query = request.uri().query().and_then(|query| query.split('&').find_map(|pair| pair.strip_prefix("token=")));
    ASSETS.iter().any(|asset| asset.path == request.uri().path())
        || [header, query].into_iter().flatten().any(|shown| same(shown, token))
}

/// Compares in a time that does not tell how much agrees.
fn same(shown: &str, token: &str) -> bool {
    shown.len() == token.len() && shown.bytes().zip(token.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}
