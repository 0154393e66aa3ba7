//! The domain of every field of a schedule.

use super::{Decay, LATEST_WINDOW, Schedule};
use crate::error::ScheduleError;
use crate::loss::Dssim;
use gs_core::Camera;

impl Schedule {
    /// Verifies that the loss can be computed on images of these cameras, reduced as the stages say.
    ///
    /// # Errors
    /// If MS-SSIM is asked for and a side is too short.
    pub(crate) fn check_images<'a>(
        &self,
        cameras: impl Iterator<Item = &'a Camera> + Clone,
    ) -> Result<(), ScheduleError> {
        let needed = if self.lambda_dssim > 0.0 { self.dssim } else { Dssim::Ssim };
        self.ordered().into_iter().try_for_each(|(_, stage)| {
            cameras.clone().map(|c| c.scaled(stage.image_scale)).try_for_each(|c| needed.check_size(c.width, c.height))
        })
    }

    /// Verifies every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn check(&self) -> Result<(), ScheduleError> {
        let need = |good: bool, field: &str, value: f64, rule| {
            if good { Ok(()) } else { Err(ScheduleError { field: field.to_owned(), value, rule }) }
        };
        let share = |v: f32| (0.0..=1.0).contains(&v);
        let total: u64 = self.stages.values().map(|s| u64::from(s.steps)).sum();
        need(total > 0 && total < 1 << 31, "stages", total as f64, "the steps must add up to 1 to 2^31 - 1")?;
        need(share(self.lambda_dssim), "lambda_dssim", self.lambda_dssim.into(), "0 to 1")?;
        let l1 = self.lambda_l1.unwrap_or(0.0);
        need(l1 >= 0.0 && l1.is_finite(), "lambda_l1", l1.into(), "finite, not negative")?;
        need((1..=256).contains(&self.batch), "batch", self.batch.into(), "1 to 256")?;
        let lr_batch = self.lr_batch.unwrap_or(1);
        need((1..=256).contains(&lr_batch), "lr_batch", lr_batch.into(), "1 to 256")?;
        // Images of the step after the last may be decoded ahead.
        let drawn = (total + 1) * u64::from(self.batch);
        need(drawn < 1 << 32, "batch", self.batch.into(), "steps times batch below 2^32")?;
        let fre = self.lambda_fre;
        need(fre >= 0.0 && fre.is_finite(), "lambda_fre", fre.into(), "finite, not negative")?;
        let depth = self.lambda_depth;
        need(depth >= 0.0 && depth.is_finite(), "lambda_depth", depth.into(), "finite, not negative")?;
        need(share(self.max_quarantine), "max_quarantine", self.max_quarantine.into(), "0 to 1")?;
        need(self.near > 0.0 && self.near.is_finite(), "near", self.near, "above 0, finite")?;
        let dilation = self.dilation;
        need(dilation >= 0.0 && dilation.is_finite(), "dilation", dilation, "finite, not negative")?;
        need(self.adam_eps > 0.0 && self.adam_eps < 1.0, "adam_eps", self.adam_eps.into(), "above 0, below 1")?;
        for (name, s) in &self.stages {
            let good = s.image_scale > 0.0 && s.image_scale <= 1.0;
            need(good, &format!("stages.{name}.image_scale"), s.image_scale, "above 0, at most 1")?;
            let until = s.window_until;
            need((0.0..=LATEST_WINDOW).contains(&until), &format!("stages.{name}.window_until"), until, "0 to 0.7")?;
            let closed = s.window_parts > 1 && until == 0.0;
            need(!closed, &format!("stages.{name}.window_until"), until, "above 0 where window_parts is above 1")?;
            let newest = s.window_newest;
            need((0.0..=0.5).contains(&newest), &format!("stages.{name}.window_newest"), newest, "0 to 0.5")?;
            let same = self.stages.values().filter(|o| o.order == s.order).count();
            need(same == 1, &format!("stages.{name}.order"), s.order.into(), "each stage needs a number of its own")?;
        }
        let rates =
            self.lr.iter().flat_map(|(group, rates)| rates.iter().map(move |r| (format!("{group}.{}", r.0), r.1)));
        for (name, rate) in rates {
            for (part, v) in [("start", rate.start), ("end", rate.end)] {
                need(v >= 0.0 && v.is_finite(), &format!("lr.{name}.{part}"), v.into(), "finite, not negative")?;
            }
            let decays = rate.steps > 0 && rate.start > 0.0 && rate.decay == Decay::Log;
            need(rate.end > 0.0 || !decays, &format!("lr.{name}.end"), 0.0, "above 0 (the decay is log-linear)")?;
            need((0.0..1.0).contains(&rate.eps), &format!("lr.{name}.eps"), rate.eps.into(), "0 or more, below 1")?;
            need(share(rate.weight_decay), &format!("lr.{name}.weight_decay"), rate.weight_decay.into(), "0 to 1")?;
        }
        self.density.check()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Stage;
    use super::super::tests::{rate, schedule, stage};
    use super::*;
    use glam::DVec3;

    #[test]
    fn faults_are_named_and_toml_round_trips() {
        let good = schedule(vec![stage(10, false)]);
        assert_eq!(good.check(), Ok(()));
        assert_eq!(toml::from_str::<Schedule>(&toml::to_string(&good).unwrap()).unwrap(), good);
        let fault = |f: &dyn Fn(&mut Schedule)| {
            let mut s = good.clone();
            f(&mut s);
            s.check().unwrap_err().field
        };
        assert_eq!(fault(&|s| s.stages.clear()), "stages");
        let first = |s: &mut Schedule, f: &dyn Fn(&mut Stage)| s.stages.values_mut().for_each(f);
        assert_eq!(fault(&|s| first(s, &|s| s.steps = 0)), "stages");
        assert_eq!(fault(&|s| first(s, &|s| s.image_scale = f64::NAN)), "stages.s.image_scale");
        let twice = |s: &mut Schedule| {
            s.stages.insert("r".into(), stage(1, false));
        };
        assert_eq!(fault(&twice), "stages.r.order");
        assert_eq!(fault(&|s| s.adam_eps = 0.0), "adam_eps");
        assert_eq!(fault(&|s| s.near = -1.0), "near");
        assert_eq!(fault(&|s| s.lambda_dssim = 1.5), "lambda_dssim");
        assert_eq!(fault(&|s| s.lambda_fre = -0.1), "lambda_fre");
        assert_eq!(fault(&|s| s.lambda_depth = f32::NAN), "lambda_depth");
        assert_eq!(fault(&|s| s.max_quarantine = f32::NAN), "max_quarantine");
        assert_eq!(fault(&|s| rate(s, "cloud", "means").end = f32::INFINITY), "lr.cloud.means.end");
        assert_eq!(fault(&|s| rate(s, "field", "all").start = -1.0), "lr.field.all.start");
        assert_eq!(fault(&|s| rate(s, "field", "all").eps = 1.0), "lr.field.all.eps");
        assert_eq!(fault(&|s| rate(s, "field", "all").weight_decay = -0.1), "lr.field.all.weight_decay");
        assert_eq!(fault(&|s| s.dilation = -0.1), "dilation");
        assert_eq!(fault(&|s| s.density.split_factor = 0.5), "density.split_factor");
    }

    #[test]
    fn ms_ssim_is_refused_for_small_images_before_the_first_step() {
        let camera = Camera::look_at(200, 180, 0.7, DVec3::Z, DVec3::ZERO, DVec3::Y).unwrap();
        let mut s = schedule(vec![stage(10, false), stage(10, false)]);
        s.dssim = Dssim::MsSsim;
        assert_eq!(s.check_images([&camera].into_iter()), Ok(()));
        s.stages.values_mut().for_each(|stage| stage.image_scale = 0.5);
        let e = s.check_images([&camera].into_iter()).unwrap_err();
        assert_eq!((e.field.as_str(), e.value), ("dssim", 90.0));
        s.lambda_dssim = 0.0;
        assert_eq!(s.check_images([&camera].into_iter()), Ok(()));
    }
}
