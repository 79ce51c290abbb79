use crate::data::Problem;
use crate::scene_renderer::TheatreError;
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

pub struct Refusal(pub StatusCode, pub String);

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let Self(status, problem) = self;
        let body = text(&serde_json::json!({ "error": problem }));
        let mut response = (status, [(CONTENT_TYPE, "application/json")], body).into_response();
        if status == StatusCode::SERVICE_UNAVAILABLE {
            response.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static("1"));
        }
        response
    }
}

impl From<Problem> for Refusal {
    fn from(problem: Problem) -> Self {
        let status = match problem {
            Problem::NotThere(_) => StatusCode::NOT_FOUND,
            Problem::NotYet(_) => StatusCode::SERVICE_UNAVAILABLE,
            Problem::Unreadable(_) => StatusCode::UNPROCESSABLE_ENTITY,
        };
        Self(status, problem.to_string())
    }
}

impl From<TheatreError> for Refusal {
    fn from(error: TheatreError) -> Self {
        let status = match error {
            TheatreError::Busy => StatusCode::SERVICE_UNAVAILABLE,
            TheatreError::Broken(_) | TheatreError::Ended(_) => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self(status, error.to_string())
    }
}

pub fn text(value: &impl Serialize) -> String {
    // Numbers, strings and lists always serialise.
    serde_json::to_string(value).unwrap_or_else(|error| serde_json::json!({ "error": error.to_string() }).to_string())
}

pub fn text_of<T: Serialize>(result: &Result<T, Problem>) -> String {
    match result {
        Ok(value) => text(value),
        Err(problem) => {
            let waits = matches!(problem, Problem::NotYet(_));
            text(&serde_json::json!({ "error": problem.to_string(), "waits": waits }))
        }
    }
}

pub fn json(text: String) -> Response {
    ([(CONTENT_TYPE, "application/json")], text).into_response()
}
