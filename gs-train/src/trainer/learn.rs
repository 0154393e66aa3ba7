//! Gradients of a step: of its views, on whichever ranks these are, and of the regularisers.

use super::coding::{decode, encode};
use super::render_pass::{Phases, Stopwatch, ViewLoss, ViewPass};
use super::sums::{Columns, Sums};
use super::team::all_gather_results;
use super::{TrainError, Trainer};
use crate::clocks;
use crate::loss::LossValues;
use crate::method::{LossValue, MethodError, ViewCtx};
use crate::ranks::tree::{Node, run_of};
use crate::timestamp::Timestamp;
use gs_core::SplatsGrad;
use gs_data::{Dataset, View};
use std::borrow::Cow;
use std::ops::Range;

/// The views of a step, the leaves of its sums. They stand in the order of the data set, so that each rank has those of a part
/// of it, mostly the same images in every step.
pub(super) struct Views<'a> {
    pub step: u32,
    /// Number of each view's draw, and the view.
    pub drawn: Vec<(u32, &'a View)>,
    /// Where the views stand in the data set.
    pub indices: Vec<usize>,
}

impl Views<'_> {
    fn root(&self) -> Node {
        Node { from: 0, to: self.drawn.len() }
    }

    /// The view that is drawn last.
    fn last(&self) -> usize {
        (0..self.drawn.len()).max_by_key(|leaf| self.drawn[*leaf].0).unwrap_or_default()
    }

    pub(super) fn names(&self) -> String {
        self.drawn.iter().map(|(_, view)| view.name.as_str()).collect::<Vec<_>>().join(", ")
    }
}

/// What a step learnt.
pub(super) struct Learnt {
    /// Image loss, mean over the views.
    pub loss: LossValues,
    /// Terms of the method's own and regularisers.
    pub penalties: Vec<(Cow<'static, str>, f32)>,
    /// Most gradient rows of a view that were refused.
    pub refused: u32,
    /// Names of the views.
    pub views: String,
    /// Of the views of this rank.
    pub ms: Phases,
}

impl Trainer {
    /// Leaves the gradient of the mean loss of the step's views and of the regularisers in the model: in whole, or in the rows
    /// that this rank owns.
    pub(super) fn learn(&mut self, step: u32) -> Result<Learnt, TrainError> {
        let dataset = self.dataset.clone();
        let (views, next) = (self.views(&dataset, step), self.views(&dataset, step + 1));
        let (rank, ranks) = (self.ranks.rank(), self.ranks.size());
        let run = run_of(views.drawn.len(), rank, ranks);
        for k in run.clone() {
            self.prefetch.request(&self.images, next.drawn[k].1);
        }
        let updates = std::mem::take(&mut self.updates);
        let whole = self.model.needs_whole_gradient();
        let learns = |name: &str| whole || updates.get(name).is_some_and(Option::is_some);
        let sums = Sums::new(&mut self.model, &learns);
        let mine = self.sums_within(run, &views, &sums, &learns);
        let mut ms = Phases::default();
        mine.iter().flat_map(|(seen, _)| seen).for_each(|view| ms += view.ms);
        let mut clock = Stopwatch::new();
        let (seen, parts) = match ranks {
            1 => mine?,
            _ => all_gather_results(&*self.ranks, mine).map(|(seen, parts)| (seen.concat(), parts))?,
        };
        self.check_views(&seen, &views)?;
        for (view, index) in seen.iter().zip(&views.indices) {
            if let Some(map) = view.terms.color_map {
                self.model.exposures_mut().blend_in(*index, &map, dataset.train.len());
            }
        }
        let (sum, own) = match ranks {
            1 => (parts.into_iter().next().unwrap_or_default(), None),
            _ => (self.exchange_sums(parts, &views, &sums)?, Some((rank, ranks))),
        };
        sums.put(&mut self.model, &learns, sum, own);
        self.share_statistics()?;
        if whole {
            self.share_gradients(&learns)?;
        }
        ms.exchange = clock.lap();
        let last = views.drawn.get(views.last()).map_or_else(Timestamp::default, |(_, view)| Timestamp::new(view.time));
        let regularisers = self.model.regularise(&last);
        ms.field += clock.lap();
        self.updates = updates;
        Ok(Learnt::of(&seen, regularisers, views.names(), ms))
    }

    /// The views that a step draws.
    pub(super) fn views<'a>(&self, dataset: &'a Dataset, step: u32) -> Views<'a> {
        let batch = self.schedule().batch;
        let view = |draw| (self.order.view(self.model.schedule(), draw), draw);
        let mut drawn: Vec<(usize, u32)> = ((step - 1) * batch + 1..=step * batch).map(view).collect();
        drawn.sort_unstable();
        let indices = drawn.iter().map(|(view, _)| *view).collect();
        Views { step, indices, drawn: drawn.into_iter().map(|(view, draw)| (draw, &dataset.train[view])).collect() }
    }

    /// What the views of this rank gave, and the sums at the largest nodes over them.
    fn sums_within(
        &mut self,
        run: Range<usize>,
        views: &Views<'_>,
        sums: &Sums,
        learns: &dyn Fn(&str) -> bool,
    ) -> Result<(Vec<ViewLoss>, Vec<Columns>), TrainError> {
        let mut seen = Vec::new();
        let nodes = views.root().within(&run).into_iter();
        let parts = nodes.map(|node| self.sum(node, views, sums, learns, &mut seen)).collect::<Result<_, _>>()?;
        Ok((seen, parts))
    }

    /// The sum at a node whose leaves are all views of this rank; what each gave goes to `seen`.
    fn sum(
        &mut self,
        node: Node,
        views: &Views<'_>,
        sums: &Sums,
        learns: &dyn Fn(&str) -> bool,
        seen: &mut Vec<ViewLoss>,
    ) -> Result<Columns, TrainError> {
        match node.children() {
            None => {
                seen.push(self.learn_view(node.from, views)?);
                Ok(sums.take(&mut self.model, learns))
            }
            Some([left, right]) => {
                let mut sum = self.sum(left, views, sums, learns, seen)?;
                let right = self.sum(right, views, sums, learns, seen)?;
                sums.merge(&mut sum, right);
                Ok(sum)
            }
        }
    }

    /// One view, which counts with its share in the step: gradients and statistics.
    fn learn_view(&mut self, leaf: usize, views: &Views<'_>) -> Result<ViewLoss, TrainError> {
        let mut clock = Stopwatch::new();
        let (draw, view) = views.drawn[leaf];
        let schedule = self.model.schedule();
        let background = schedule.background.color(self.options.seed, draw);
        let of_step = (draw - 1) % schedule.batch;
        let given = self.images.camera(view);
        let row = self.model.cameras().row(view);
        let correction = row.map(|row| self.model.cameras().correction(row)).unwrap_or_default();
        let (camera, at) = (correction.apply(&given), Timestamp::new(correction.at(view.time)));
        let learns_time = correction.clock != 0.0 && self.model.refines_clocks(views.step);
        let mut pass = ViewPass {
            pass: &mut self.pass,
            images: &self.images,
            view,
            camera: &camera,
            camera_grad: row.filter(|_| self.model.refines_cameras(views.step)).map(|_| Default::default()),
            motion_grad: learns_time.then(SplatsGrad::default),
            options: schedule.raster_options(background),
            exposure: self.model.exposure(views.step, views.indices[leaf]),
            share: 1.0 / views.drawn.len() as f32,
            result: ViewLoss::default(),
            data_error: None,
        };
        let terms =
            self.model.step(&ViewCtx { at, camera: &camera, draw: of_step, last: leaf == views.last() }, &mut pass);
        let ViewPass { mut result, data_error, camera_grad, motion_grad, .. } = pass;
        if let Some(e) = data_error {
            return Err(e.into());
        }
        let terms = terms.map_err(|e| match e {
            MethodError::Loss(e) => {
                TrainError::Numeric { step: views.step, view: view.name.clone(), what: e.to_string() }
            }
            other => other.into(),
        })?;
        if let (Some(row), Some(grad)) = (row, camera_grad) {
            self.model.cameras_mut().add_gradient(row, &given, &grad);
        }
        if let (Some(row), Some(grad)) = (row, motion_grad.filter(|grad| !grad.means.is_empty())) {
            clocks::check_all_shown(grad.means.len(), self.model.splat_count(), at.t)?;
            let splats = |at: &Timestamp| self.model.splats(at, &camera);
            let slope = clocks::slope(&splats, at.t, correction.clock, &grad)?;
            self.model.cameras_mut().add_time_gradient(row, slope);
        }
        result.own = terms.into_iter().map(|(name, value)| (name.into(), value)).collect();
        let ms = &mut result.ms;
        ms.field = clock.lap() - ms.data - ms.raster_forward - ms.loss - ms.raster_backward;
        Ok(result)
    }

    /// The whole sums of the rows that this rank owns, from sums of subtrees on all ranks.
    fn exchange_sums(&self, parts: Vec<Columns>, views: &Views<'_>, sums: &Sums) -> Result<Columns, TrainError> {
        let (me, ranks) = (self.ranks.rank(), self.ranks.size());
        let mut to = vec![Vec::new(); ranks];
        for (rank, bytes) in to.iter_mut().enumerate() {
            for part in &parts {
                for (column, (values, shape)) in part.iter().zip(sums.shapes()).enumerate() {
                    let own = shape.owned(rank, ranks);
                    let known = sums.begin(column).get(own.clone()).unwrap_or_default();
                    encode(&values[own], known, shape.unit, bytes);
                }
            }
        }
        drop(parts);
        let known: Columns = (0..sums.shapes().len()).map(|column| self.own_begin(column, sums)).collect();
        let mut nodes = Vec::new();
        for (rank, bytes) in self.ranks.all_to_all(to)?.iter().enumerate() {
            let mut rest = &bytes[..];
            for node in views.root().within(&run_of(views.drawn.len(), rank, ranks)) {
                let mut part = known.clone();
                for (values, shape) in part.iter_mut().zip(sums.shapes()) {
                    decode(&mut rest, values, shape.unit).map_err(|_| TrainError::short(rank))?;
                }
                nodes.push((node, part));
            }
        }
        let mut part = |node: Node| {
            let at = nodes.iter().position(|n| n.0 == node)?;
            Some(nodes.swap_remove(at).1)
        };
        let sum = views.root().sum(&mut part, &mut |a, b| sums.merge(a, b));
        let mut sum = sum.ok_or_else(|| TrainError::short(me))?;
        sums.merge_most(&mut sum, known);
        Ok(sum)
    }

    /// What a view begins with in the rows of a column that this rank owns.
    fn own_begin(&self, column: usize, sums: &Sums) -> Vec<f32> {
        let own = sums.shapes()[column].owned(self.ranks.rank(), self.ranks.size());
        sums.begin(column).get(own.clone()).map_or_else(|| vec![0.0; own.len()], <[f32]>::to_vec)
    }

    fn check_views(&self, seen: &[ViewLoss], views: &Views<'_>) -> Result<(), TrainError> {
        for (loss, (_, view)) in seen.iter().zip(&views.drawn) {
            let (rows, of) = (loss.non_finite.rows, loss.splats);
            let Some(first) = loss.non_finite.first.filter(|_| self.too_many(rows, of)) else { continue };
            let what = format!("{rows} of {of} splats have gradients that are not finite, the first is splat {first}");
            return Err(TrainError::Numeric { step: views.step, view: view.name.clone(), what });
        }
        Ok(())
    }
}

impl Learnt {
    pub(super) fn of(seen: &[ViewLoss], regularisers: Vec<LossValue>, views: String, ms: Phases) -> Self {
        let mut learnt = Self { loss: LossValues::default(), penalties: Vec::new(), refused: 0, views, ms };
        let regularisers = regularisers.into_iter().map(|(name, value)| (name.into(), value));
        for view in seen {
            learnt.loss.add_mean(&view.terms, seen.len() as f64);
            learnt.refused = learnt.refused.max(view.non_finite.rows);
        }
        for (name, value) in seen.iter().flat_map(|view| view.own.iter().cloned()).chain(regularisers) {
            match learnt.penalties.iter_mut().find(|p| p.0 == name) {
                Some(sum) => sum.1 += value,
                None => learnt.penalties.push((name, value)),
            }
        }
        learnt
    }
}
