//! Decoding of the next step's images while the present step runs.

use gs_data::{ImageCache, ImageSource, View};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Views that may wait to be decoded.
const WAITING: usize = 8;

/// A thread that fills the image cache ahead of the trainer. It changes when an image is decoded, never what it is; an
/// error of decoding is met, and reported, by the step that needs the image.
#[derive(Default)]
pub(super) struct Prefetch(Option<Worker>);

struct Worker {
    images: Arc<ImageCache>,
    views: SyncSender<View>,
    thread: JoinHandle<()>,
}

impl Prefetch {
    /// Asks for the image of a view, if it lies in a file. Where the thread cannot follow, or none can be started, the
    /// request is dropped.
    pub(super) fn request(&mut self, images: &Arc<ImageCache>, view: &View) {
        if !matches!(view.image, ImageSource::File(_)) || !images.keeps_images() {
            return;
        }
        if self.0.as_ref().is_none_or(|w| !Arc::ptr_eq(&w.images, images)) {
            self.stop();
            self.0 = Worker::start(images.clone());
        }
        if let Some(worker) = &self.0 {
            let _ = worker.views.try_send(view.clone());
        }
    }

    fn stop(&mut self) {
        if let Some(Worker { views, thread, .. }) = self.0.take() {
            drop(views);
            // The thread cannot panic on data: decoding returns errors.
            let _ = thread.join();
        }
    }
}

impl Drop for Prefetch {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Worker {
    fn start(images: Arc<ImageCache>) -> Option<Self> {
        let (views, waiting) = sync_channel::<View>(WAITING);
        let cache = images.clone();
        let decode = move || waiting.iter().for_each(|view| drop(cache.decode_ahead(&view)));
        let thread = std::thread::Builder::new().name("prefetch images".into()).spawn(decode).ok()?;
        Some(Self { images, views, thread })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_core::io::images::save_png;
    use gs_core::{Camera, Image, Time};

    #[test]
    fn files_are_decoded_ahead_and_bad_ones_are_left_to_the_step() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (good, bad) = (folder.path().join("good.png"), folder.path().join("bad.png"));
        save_png(&good, &Image::zeros(8, 8, 3), false).expect("a file");
        std::fs::write(&bad, b"no image").expect("a file");
        let camera = Camera::look_at(8, 8, 0.7, DVec3::Z, DVec3::ZERO, DVec3::Y).expect("a camera");
        let view = |file| View::new("v", camera.clone(), Time::default(), ImageSource::File(file), 0);
        let images = Arc::new(ImageCache::new(1 << 20, 1.0));
        let mut prefetch = Prefetch::default();
        prefetch.request(&images, &view(bad));
        prefetch.request(&images, &view(good.clone()));
        drop(prefetch);
        assert_eq!(images.decoded(), 1);
        images.get(&view(good)).expect("an image");
        assert_eq!(images.decoded(), 1, "the step finds it decoded");
    }
}
