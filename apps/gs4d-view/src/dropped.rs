//! Splat files that are dropped onto the page: they become shows of this viewer, for all pages that open it later.

use crate::routes::{refuse, text_of, token_of};
use crate::server::Shared;
use crate::stage::Show;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use gs_core::io::{Limits, parse_splats};
use serde_json::json;
use std::sync::Arc;

/// Largest file, bytes.
pub(crate) const MAX_BYTES: usize = 256 << 20;
/// Most shows of a viewer, files that were dropped included.
const MAX_SHOWS: usize = 32;

/// Takes the body of a request as a splat file; its name is the query's `name`. Answers with the description of the new show.
pub(crate) async fn take(State(shared): State<Arc<Shared>>, headers: HeaderMap, uri: Uri, body: Bytes) -> Response {
    let guard = &shared.guard;
    if !guard.host(text_of(&headers, header::HOST)) || !guard.origin(text_of(&headers, header::ORIGIN)) {
        return refuse("not a page of this server");
    }
    if !guard.knows(token_of(&uri)) {
        return refuse("wrong key");
    }
    let name = name_of(&uri);
    let read = tokio::task::spawn_blocking(move || {
        let splats = parse_splats(&body, &name, &Limits::default()).and_then(|raw| Ok(raw.to_splats()?));
        splats.map(|s| Show::splats(name, s)).map_err(|e| e.to_string())
    });
    let show = match read.await {
        Ok(Ok(show)) => show,
        Ok(Err(why)) => return (StatusCode::UNPROCESSABLE_ENTITY, why).into_response(),
        Err(_) => return (StatusCode::INTERNAL_SERVER_ERROR, "the file could not be read").into_response(),
    };
    let about = show.about();
    match shared.stage.add(show, MAX_SHOWS) {
        Some(number) => json!({"number": number, "show": about}).to_string().into_response(),
        None => (StatusCode::CONFLICT, format!("a viewer shows at most {MAX_SHOWS} scenes")).into_response(),
    }
}

/// The file name in a query `name=…`, percent-encoded, without folders and control characters.
fn name_of(uri: &Uri) -> String {
    let given = uri.query().into_iter().flat_map(|q| q.split('&')).find_map(|pair| pair.strip_prefix("name="));
    let mut bytes = Vec::new();
    let mut rest = given.unwrap_or("file").bytes();
    while let Some(byte) = rest.next() {
        let digit = |b: Option<u8>| b.and_then(|b| char::from(b).to_digit(16)).and_then(|d| u8::try_from(d).ok());
        bytes.push(match byte {
            b'%' => 16 * digit(rest.next()).unwrap_or(0) + digit(rest.next()).unwrap_or(0),
            other => other,
        });
    }
    let name = String::from_utf8_lossy(&bytes);
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    last.chars().filter(|c| !c.is_control()).take(100).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_decoded_and_hold_no_folder() {
        let name = |query: &str| name_of(&format!("/drop?k=1&{query}").parse().unwrap());
        assert_eq!(name("name=a%20b%C3%A9.ply"), "a bé.ply");
        assert_eq!(name("name=..%2F..%2Fetc%2Fpasswd"), "passwd");
        assert_eq!(name("name=%"), "");
        assert_eq!(name("x=1"), "file");
    }
}
