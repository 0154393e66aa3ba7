//! Splat files that are dropped onto the page: they become shows of this viewer, for all its pages.

use crate::routes::stranger;
use crate::server::Shared;
use crate::stage::Show;
use axum::Extension;
use axum::body::{Body, to_bytes};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use gs_core::io::{Limits, parse_splats};
use percent_encoding::percent_decode_str;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest file, bytes.
const MAX_BYTES: usize = 256 << 20;
/// Largest memory of the splats of a file, bytes.
const MAX_MEMORY: u64 = 1 << 30;
/// Most shows of a viewer to which files can be added.
const MAX_SHOWS: usize = 8;

/// Whether the connection of a request carries a file, and may therefore last longer than others.
#[derive(Clone, Default)]
pub(crate) struct Upload(pub(crate) Arc<AtomicBool>);

/// Takes the body of a request as a splat file; its name is the query's `name`. Answers with the number of the new show and all shows.
/// Nothing of the body is read before the request has shown the key, and one file is taken at a time.
pub(crate) async fn take(
    State(shared): State<Arc<Shared>>,
    Extension(upload): Extension<Upload>,
    headers: HeaderMap,
    uri: Uri,
    body: Body,
) -> Response {
    if let Some(refusal) = stranger(&shared, &headers, &uri) {
        return refusal;
    }
    let full = || (StatusCode::CONFLICT, format!("a viewer takes files up to {MAX_SHOWS} scenes")).into_response();
    if shared.stage.shows().len() >= MAX_SHOWS {
        return full();
    }
    upload.0.store(true, Ordering::SeqCst);
    let _turn = shared.uploads.lock().await;
    let Ok(bytes) = to_bytes(body, MAX_BYTES).await else {
        return (StatusCode::PAYLOAD_TOO_LARGE, format!("a file has at most {MAX_BYTES} bytes")).into_response();
    };
    let name = name_of(&uri);
    let state = shared.clone();
    let added = tokio::task::spawn_blocking(move || {
        let limits = Limits { max_memory: MAX_MEMORY, ..Limits::default() };
        let read = || parse_splats(&bytes, &name, &limits).and_then(|raw| Ok((raw.to_splats()?, raw.antialiased)));
        let (splats, antialiased) = state.in_pool(read).map_err(|e| e.to_string())?;
        let show = Show::splats(name.clone(), splats).antialiased(antialiased);
        Ok(state.stage.add(show, MAX_SHOWS).map(|number| {
            let mut about = state.in_pool(|| state.stage.about());
            state.listed.send_replace(json!({"listed": about["shows"]}).to_string());
            about["number"] = json!(number);
            about.to_string()
        }))
    });
    match added.await {
        Ok(Ok(Some(answer))) => answer.into_response(),
        Ok(Ok(None)) => full(),
        Ok(Err(why)) => {
            let why: String = why;
            (StatusCode::UNPROCESSABLE_ENTITY, why).into_response()
        }
        Err(_) => (StatusCode::INTERNAL_SERVER_ERROR, "the file could not be read").into_response(),
    }
}

/// The file name in a query `name=…`, percent-encoded, without folders and control characters.
fn name_of(uri: &Uri) -> String {
    let given = uri.query().into_iter().flat_map(|q| q.split('&')).find_map(|pair| pair.strip_prefix("name="));
    let name = percent_decode_str(given.unwrap_or("file")).decode_utf8_lossy();
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
        assert_eq!(name("name=%"), "%");
        assert_eq!(name("x=1"), "file");
    }
}
