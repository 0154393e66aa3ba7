use super::*;

/// Scores of one image with equal confidence.
fn one(predicted: &[u32], truth: &[u32]) -> SegmentScores {
    scores(&[(predicted, truth, &vec![1.0; truth.len()])])
}

fn scores(images: &[(&[u32], &[u32], &[f32])]) -> SegmentScores {
    let mut all = Segmentation::default();
    images.iter().for_each(|(p, t, c)| all.add(p, t, c).unwrap());
    all.scores().unwrap()
}

fn near(got: SegmentScores, want: [f64; 6]) {
    let got = [got.ap, got.pq, got.f1, got.precision, got.recall, got.miou];
    for (g, w) in got.iter().zip(want) {
        assert!((g - w).abs() < 1e-12, "{got:?}, wanted {want:?}");
    }
}

const FOUR: [u32; 8] = [0, 0, 1, 1, 2, 2, 3, 3];

#[test]
fn renamed_ids_score_one() {
    let renamed = FOUR.map(|id| 17 - 3 * id);
    near(one(&renamed, &FOUR), [1.0; 6]);
    assert_eq!(one(&renamed, &FOUR).miou_strict, 1.0);
}

/// Instance 0 of 8 pixels is cut 6 : 2; instance 1 is whole.
#[test]
fn split() {
    let truth = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1];
    let predicted = [5, 5, 5, 5, 5, 5, 6, 6, 7, 7, 7, 7];
    // Matched: 5 with 0.75, 7 with 1; 6 is false. AP: equal confidences, in the order T F T: precision 1 up to recall ½, then ⅔.
    let ap = (51.0 + 50.0 * 2.0 / 3.0) / 101.0;
    near(one(&predicted, &truth), [ap, 1.75 / 2.5, 0.8, 2.0 / 3.0, 1.0, 0.875]);
}

/// Two instances of 6 and 2 pixels predicted as one.
#[test]
fn merged() {
    let truth = [0, 0, 0, 0, 0, 0, 1, 1];
    near(one(&[4; 8], &truth), [51.0 / 101.0, 0.75 / 1.5, 2.0 / 3.0, 1.0, 0.5, 0.375]);
}

/// Instance 1 is predicted as background.
#[test]
fn missing() {
    let truth = [0, 0, 0, 0, 0, 0, 0, 1, 2, 2];
    let predicted = [0, 0, 0, 0, 0, 0, 0, 0, 2, 2];
    let ap = 67.0 / 101.0;
    near(one(&predicted, &truth), [ap, (7.0 / 8.0 + 1.0) / 2.5, 0.8, 1.0, 2.0 / 3.0, (7.0 / 8.0 + 1.0) / 3.0]);
}

/// Two halves overlap with exactly ½ each: one is matched, the other is a false positive. Below ½ neither is matched.
#[test]
fn a_tie_at_one_half() {
    let ap = 1.0;
    near(one(&[1, 1, 2, 2], &[0; 4]), [ap, 0.5 / 1.5, 2.0 / 3.0, 0.5, 1.0, 0.5]);
    near(one(&[1, 1, 2, 2, 3], &[0; 5]), [0.0, 0.0, 0.0, 0.0, 0.0, 0.4]);
}

/// Ids absent from an image but below the largest count 0 only in the strict mean.
#[test]
fn absent_ids_count_in_the_strict_mean_only() {
    let s = one(&[9, 9, 8, 8], &[0, 0, 3, 3]);
    assert_eq!((s.miou, s.miou_strict, s.pq), (1.0, 0.5, 1.0));
}

/// A false instance lowers AP only if its confidence exceeds that of matched ones; images are pooled.
#[test]
fn confidence_orders_predictions_over_images() {
    let truth = [0, 0, 0, 0, 1, 1, 1, 1];
    let good = [0, 0, 0, 0, 1, 1, 1, 1];
    let bad = [0, 0, 0, 0, 1, 1, 2, 3];
    let high = [0.9f32; 8];
    let mut mixed = high;
    mixed[6..].fill(0.1);
    let s = scores(&[(&good, &truth, &high), (&bad, &truth, &mixed)]);
    assert_eq!((s.images, s.recall, s.precision), (2, 1.0, 4.0 / 6.0));
    assert!((s.ap - 1.0).abs() < 1e-12, "false ones come last: {}", s.ap);
    let mut inverted = [0.5f32; 8];
    inverted[6..].fill(1.0);
    let s = scores(&[(&good, &truth, &high), (&bad, &truth, &inverted)]);
    // Order F F T T T T: the envelope is 4/6 everywhere.
    assert!((s.ap - 4.0 / 6.0).abs() < 1e-12, "{}", s.ap);
    assert!((s.miou - (2.0 + 1.5) / 4.0).abs() < 1e-12);
}

#[test]
fn ids_are_aligned_over_a_sequence() {
    let mut overlap = Overlap::of(&[7, 7, 7, 2, 2, 5], &[0, 0, 0, 1, 1, 1]).unwrap();
    overlap.add(&[7, 7, 2, 2, 2, 5], &[0, 0, 1, 1, 1, 1]).unwrap();
    assert_eq!(overlap.aligned(), BTreeMap::from([(7, 0), (2, 1)]));
    assert_eq!((overlap.shared(5, 1), overlap.iou(5, 1), overlap.iou(99, 99)), (2, 2.0 / 7.0, 0.0));
}

#[test]
fn bad_images_are_errors_that_name_the_fault() {
    let mut all = Segmentation::default();
    assert!(all.scores().is_none());
    assert!(matches!(all.add(&[0, 1], &[0], &[1.0, 1.0]), Err(MetricError::Shape { .. })));
    assert!(matches!(all.add(&[0, 1], &[0, 1], &[1.0]), Err(MetricError::Shape { .. })));
    assert!(matches!(all.add(&[], &[], &[]), Err(MetricError::Shape { .. })));
    let nan = all.add(&[0, 1], &[0, 1], &[1.0, f32::NAN]).unwrap_err();
    assert!(matches!(nan, MetricError::NotFinite { x: 1, .. }), "{nan}");
    assert_eq!(all.scores(), None, "nothing is counted in part");
}
