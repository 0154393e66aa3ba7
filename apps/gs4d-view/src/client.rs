//! One browser: its questions come in, of which the newest counts; answers and news go out.

use crate::outbox::Sending;
use crate::question::{Demand, MAX_NESTING, Question, Save, nesting};
use crate::server::Shared;
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use serde_json::{Value, json};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tokio::task::JoinSet;

/// Most browsers connected at once.
pub(crate) const MAX_CLIENTS: usize = 32;
/// A browser that does not take an answer within this time, plus its size at [`MIN_RATE`], is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// Bytes per second.
const MIN_RATE: f64 = 100e3;
/// How often a browser is asked for a sign of life, and how long it may give none.
const PULSE: [Duration; 2] = [Duration::from_secs(10), Duration::from_secs(40)];
/// A browser without a question for this long is disconnected.
const IDLE_TIMEOUT: Duration = Duration::from_secs(3600);

/// The place of a connected browser; free again when dropped.
pub(crate) struct Place(Arc<Shared>);

impl Place {
    /// A free place, if there is one.
    pub(crate) fn take(shared: &Arc<Shared>) -> Option<Self> {
        let place = Self(shared.clone());
        (shared.clients.fetch_add(1, Ordering::SeqCst) < MAX_CLIENTS).then_some(place)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.clients.fetch_sub(1, Ordering::SeqCst);
        self.0.release_buffers();
    }
}

/// The newest question that is not being answered.
type Newest = Arc<Mutex<Option<Question>>>;

/// What a browser gets for a question.
enum Answer {
    /// A JSON text.
    Text(Value),
    /// An image or a file, with its header.
    Bytes(Sending),
}

/// Serves one browser until it leaves, breaks a limit, or does not read. One image at a time is rendered or sent.
pub(crate) async fn serve(mut socket: WebSocket, shared: &Arc<Shared>) {
    let (mut news, mut listed) = (shared.news.subscribe(), shared.listed.subscribe());
    let Some(mut greeting) = about(shared).await else { return };
    greeting["version"] = json!(env!("CARGO_PKG_VERSION"));
    if let Value::Object(training) = shared.training() {
        greeting.as_object_mut().into_iter().for_each(|all| all.extend(training.clone()));
    }
    let (mut asked, mut heard) = (Instant::now(), Instant::now());
    let mut pulse = tokio::time::interval_at(tokio::time::Instant::now() + PULSE[0], PULSE[0]);
    let newest = Newest::default();
    let mut rendering = JoinSet::new();
    let mut reads = send(&mut socket, &greeting).await;
    while reads {
        let next = newest.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(Question::work);
        if let Some(pixels) = next.filter(|_| rendering.is_empty()) {
            rendering.spawn(rendered(shared.clone(), newest.clone(), pixels));
        }
        reads = tokio::select! {
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) if nesting(&text) <= MAX_NESTING => match Demand::parse(&text) {
                    Ok(Demand::Pause { pause }) => {
                        shared.pause(pause);
                        (asked, heard) = (Instant::now(), Instant::now());
                        true
                    }
                    Ok(Demand::Image(question)) => {
                        *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(*question);
                        (asked, heard) = (Instant::now(), Instant::now());
                        true
                    }
                    Err(why) => send(&mut socket, &json!({"id": id_of(&text), "error": why})).await,
                },
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {
                    heard = Instant::now();
                    true
                }
                _ => break,
            },
            _ = pulse.tick() => {
                let paused = shared.paused.load(Ordering::SeqCst);
                !is_gone(heard.elapsed(), asked.elapsed(), paused) && ping(&mut socket).await
            }
            Some(answer) = rendering.join_next() => match answer {
                Ok(Some(Answer::Text(text))) => send(&mut socket, &text).await,
                Ok(Some(Answer::Bytes(bytes))) => {
                    let taken = send_parts(&mut socket, &bytes).await;
                    // While an answer was on its way nothing was listened to.
                    heard = Instant::now();
                    taken
                }
                Ok(None) => true,
                Err(_) => false,
            },
            Ok(()) = listed.changed() => {
                let text = listed.borrow_and_update().clone();
                send_text(&mut socket, text).await
            }
            Ok(()) = news.changed() => {
                let text = news.borrow_and_update().clone();
                send_text(&mut socket, text.unwrap_or_default()).await
            }
        };
    }
    if reads {
        let bye = CloseFrame { code: 1000, reason: "".into() };
        let _ = tokio::time::timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(bye)))).await;
    }
}

/// Whether a browser has to go: it gives no sign of life, or asks for nothing for long. While a training is paused it may be silent: the pause
/// lasts until the last browser leaves.
fn is_gone(heard: Duration, asked: Duration, paused: bool) -> bool {
    heard > PULSE[1] || (asked > IDLE_TIMEOUT && !paused)
}

/// What a page is told of all shows.
async fn about(shared: &Arc<Shared>) -> Option<Value> {
    let state = shared.clone();
    tokio::task::spawn_blocking(move || state.in_pool(|| state.stage.about())).await.ok()
}

/// The id of a question that is refused.
fn id_of(text: &str) -> Option<u64> {
    serde_json::from_str::<Value>(text).ok()?["id"].as_u64()
}

/// Waits for a turn and answers the newest question, in a task that ends also if the browser leaves. The turn is kept until the
/// share of the machine allows the next image.
async fn rendered(shared: Arc<Shared>, newest: Newest, pixels: u64) -> Option<Answer> {
    let turn = shared.turns.wait(pixels).await?;
    let question = newest.lock().unwrap_or_else(PoisonError::into_inner).take()?;
    let (id, (done, answered)) = (question.id, oneshot::channel());
    tokio::spawn(async move {
        let state = shared.clone();
        let work = tokio::task::spawn_blocking(move || answer(&state, &question)).await;
        // The browser may have left.
        let _ = done.send(work.ok());
        shared.release_buffers();
        if let Some(pace) = &shared.pace {
            tokio::time::sleep_until(pace.ready().into()).await;
        }
        drop(turn);
    });
    let failed = || Answer::Text(json!({"id": id, "error": "the image could not be rendered"}));
    Some(answered.await.ok().flatten().unwrap_or_else(failed))
}

/// The answer as bytes: lengths of header and body (u32 each, little-endian), header (JSON), body (image or file).
fn answer(shared: &Arc<Shared>, question: &Question) -> Answer {
    let begun = Instant::now();
    let mut renderer = shared.renderer.blocking_lock();
    let answer = shared.in_pool(|| renderer.answer(&shared.stage, question, shared.packing));
    if let Some(pace) = &shared.pace {
        pace.spent(begun.elapsed());
    }
    match answer {
        Ok(answer) => {
            let header = answer.header.to_string().into_bytes();
            let [Ok(head), Ok(body)] = [&header, &answer.bytes].map(|b| u32::try_from(b.len())) else {
                return Answer::Text(json!({"id": question.id, "error": "the file is larger than 4 GiB"}));
            };
            let lengths = [head.to_le_bytes(), body.to_le_bytes()];
            let all = [lengths.as_flattened(), &header, &answer.bytes].concat();
            match shared.outbox.put(all, question.save == Some(Save::Splats)) {
                Some(sending) => Answer::Bytes(sending),
                None => Answer::Text(json!({"id": question.id, "later": true})),
            }
        }
        Err(why) => Answer::Text(json!({"id": question.id, "error": why})),
    }
}

/// Sends an answer as binary messages; false if the browser does not take it or it made room for others.
async fn send_parts(socket: &mut WebSocket, answer: &Sending) -> bool {
    let time = SEND_TIMEOUT + Duration::from_secs_f64(answer.length as f64 / MIN_RATE);
    let parts = async {
        let mut from = 0;
        while from < answer.length {
            let Some(part) = answer.part(from) else { return false };
            from += part.len();
            if socket.send(Message::Binary(part.into())).await.is_err() {
                return false;
            }
        }
        true
    };
    tokio::time::timeout(time, parts).await.unwrap_or(false)
}

async fn send(socket: &mut WebSocket, value: &Value) -> bool {
    send_text(socket, value.to_string()).await
}

async fn ping(socket: &mut WebSocket) -> bool {
    matches!(tokio::time::timeout(SEND_TIMEOUT, socket.send(Message::Ping(Vec::new().into()))).await, Ok(Ok(())))
}

/// Sends a text; false if the browser does not take it.
async fn send_text(socket: &mut WebSocket, text: String) -> bool {
    matches!(tokio::time::timeout(SEND_TIMEOUT, socket.send(Message::Text(text.into()))).await, Ok(Ok(())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_holds_a_training_may_be_silent_but_not_dead() {
        let (now, long) = (Duration::ZERO, 2 * IDLE_TIMEOUT);
        assert!(!is_gone(now, long, true) && is_gone(now, long, false));
        assert!(is_gone(2 * PULSE[1], now, true) && is_gone(2 * PULSE[1], now, false) && !is_gone(now, now, false));
    }
}
