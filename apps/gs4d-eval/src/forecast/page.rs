//! The HTML page of a forecast: PSNR over time beyond the last training time, and frames.

use crate::forecast::{Physics, TimedBody, TimestampScores};
use gs4d_report::chart::{Curve, Scale, chart};
use gs4d_report::html::{captioned, document, section, table, wrapped};
use gs4d_report::{ReportError, Still};

const BODIES: &str = "Each moves along one path, fitted to the frames before: with the standard deviation of where its splats are \
                      forecast to be, in world units.";

/// Renders a forecast as one self-contained HTML page; its frames are later than the first of two times, training ends at the second.
///
/// # Errors
/// If a chart or image cannot be encoded.
pub fn page(
    title: &str,
    [from, last]: [f64; 2],
    moments: &[TimestampScores],
    strip: &[Still],
    physics: Option<&Physics>,
    bodies: &[TimedBody],
) -> Result<String, ReportError> {
    let curve = |name: &str, psnr: fn(&TimestampScores) -> Option<f64>| Curve {
        name: name.to_owned(),
        points: moments.iter().filter_map(|m| Some((m.beyond, psnr(m)?))).collect(),
    };
    let curves = [curve("all pixels", |m| m.psnr), curve("where masks count", |m| m.masked_psnr)];
    let curves: Vec<Curve> = curves.into_iter().filter(|c| !c.points.is_empty()).collect();
    let svg = chart("PSNR, dB", "normalised time beyond the last training time", Scale::Linear, &curves)?;
    let chart = svg.map_or(String::new(), |svg| format!("<div class=\"charts\">\n<figure>{svg}</figure>\n</div>\n"));
    let mut stills = String::new();
    for still in strip {
        stills += &captioned(&still.image, &still.caption)?;
    }
    let rows = physics.into_iter().flat_map(|p| &p.spreads).map(|s| {
        let number = |v: f64| format!("{v:.4}");
        vec![s.name.to_owned(), number(s.median), number(s.p90), number(s.p99), number(s.max), s.unit.clone()]
    });
    let learnt = table(&["", "median", "90 %", "99 %", "largest", "unit"], &[1, 2, 3, 4], rows);
    let rows = bodies.iter().map(|TimedBody { body: b, .. }| {
        let number = |v: Option<&f64>| v.map_or_else(String::new, |v| format!("{v:.4}"));
        let length = |v: [f64; 3]| number(Some(&v.iter().map(|v| v * v).sum::<f64>().sqrt()));
        let [first, last] = [b.deviations.first(), b.deviations.last()].map(number);
        let motion = [b.velocity, b.spin, b.acceleration].map(length);
        [vec![b.path.to_owned(), b.splats.to_string(), b.frames.to_string()], motion.into(), vec![first, last]].concat()
    });
    let unit = bodies.first().map_or("", |b| b.unit);
    let motion = [format!("speed, units/{unit}"), format!("spin, rad/{unit}"), format!("acceleration, units/{unit}²")];
    let [speed, spin, acceleration] = motion.each_ref().map(String::as_str);
    let head = ["path", "splats", "frames", speed, spin, acceleration, "1 sigma, first frame", "1 sigma, last frame"];
    let bodies = table(&head, &[1, 2, 3, 4, 5, 6, 7], rows);
    let parts = section("Against the truth", "Means over all views of each time.", &chart)
        + &section("Frames", "", &wrapped("strip", stills))
        + &section("What was learnt of the motion", "Visible splats.", &learnt)
        + &section("Rigid bodies", BODIES, &bodies);
    let lead = match from == last {
        true => "Frames after the last training time.".to_owned(),
        false => format!("Frames after time {from:.4}; training ends at {last:.4}."),
    };
    Ok(document(title, &lead, &parts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Image;
    use gs_train::capabilities::RigidBody;

    #[test]
    fn the_page_holds_what_there_is_and_escapes_names() {
        let moment = |t: f64| TimestampScores {
            time: 0.75 + t,
            beyond: t,
            views: 3,
            psnr: Some(30.0 - 40.0 * t),
            ssim: 0.9,
            masked_psnr: None,
        };
        let image = Image { width: 1, height: 1, channels: 3, data: vec![0.5; 3] };
        let still = Still { caption: "t = 0.8".into(), image };
        let body = RigidBody {
            path: "fall",
            splats: 12,
            centroid: [0.0; 3],
            velocity: [3.0, 0.0, 4.0],
            spin: [0.0; 3],
            acceleration: [0.0, 0.0, -9.81],
            frames: 8,
            deviations: vec![0.01, 0.02],
        };
        let body = TimedBody { body, unit: "s" };
        let html = page("<b>", [0.75, 0.75], &[moment(0.1), moment(0.2)], &[still], None, &[body]).unwrap();
        assert_eq!((html.matches("<svg").count(), html.matches("data:image/png").count()), (1, 1));
        let values = ["<td>fall", ">12<", ">8<", ">5.0000<", ">9.8100<", ">0.0100<", ">0.0200<"];
        assert!(values.iter().all(|v| html.contains(v)), "{html}");
        let heads = [">speed, units/s<", ">spin, rad/s<", ">acceleration, units/s²<"];
        assert!(heads.iter().all(|head| html.contains(head)), "{html}");
        assert!(html.contains("&lt;b&gt;") && !html.contains("What was learnt"));
        let empty = page("x", [0.2, 0.75], &[], &[], None, &[]).unwrap();
        assert!(!empty.contains("<svg") && !empty.contains("<section"));
    }
}
