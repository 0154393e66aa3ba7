//! The views whose poses are checked: all of up to [`MAX_VIEWS`], a selection of more; held-out views too.

use gs_data::{Dataset, Split, View};

/// Most views in which corners are detected.
const MAX_VIEWS: usize = 200;

/// Split and index of the views that are checked.
pub(super) struct Views(pub(super) Vec<(Split, usize)>);

impl Views {
    pub(super) fn of(data: &Dataset) -> Self {
        let of_split = |s: Split| (0..data.views(s).len()).map(move |i| (s, i));
        let all: Vec<(Split, usize)> = [Split::Train, Split::Val, Split::Test].into_iter().flat_map(of_split).collect();
        Self(gs_data::spread(all.len(), MAX_VIEWS).into_iter().map(|k| all[k]).collect())
    }

    pub(super) fn list<'a>(&self, data: &'a Dataset) -> Vec<&'a View> {
        self.0.iter().map(|&(s, i)| &data.views(s)[i]).collect()
    }
}
