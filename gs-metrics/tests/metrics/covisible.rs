//! Co-visibility of generated images whose truth is known pixel by pixel.
//!
//! An object with a pattern of its own lies before a wall with another. In the images of the set it stands on the left, in the
//! test image on the right, so a part of the wall is shown by the test image alone. Both patterns are noise without coarse
//! features: the object moves too far for the flow, which is the hardest case for the colours.
//!
//! | pixels of the test image | share that is said to be co-visible |
//! |---|---|
//! | wall that the images hide | at most 0.2 (by the flow alone: at least 0.8) |
//! | wall that they show, at least 8 pixels from what they do not | at least 0.97 |

use crate::images::{in_pool, noise};
use gs_core::Image;
use gs_metrics::{CovisibleOptions, MetricError, Seen, seen};

const SIZE: [usize; 2] = [160, 120];
/// Side of the object and its upper edge, pixels.
const SIDE: usize = 56;
const TOP: usize = 32;
/// Left edge of the object in the test image, and in the `k`-th of the set.
const LEFT: usize = 92;
const IMAGES: usize = 8;

fn left_of(k: usize) -> usize {
    16 + 2 * k
}

/// Noise in patches of about four pixels, `[H, W, 1]`.
fn pattern(width: usize, height: usize, seed: u64) -> Image {
    let mut image = noise(width, height, 1, 0.0, 1.0, seed);
    for _ in 0..2 {
        let around = |k: usize, image: &Image| {
            let (x, y) = (k % width, k / width);
            let at = |i: usize, j: usize| image.pixel((x + i + width - 1) % width, (y + j + height - 1) % height)[0];
            (0..9).map(|n| at(n % 3, n / 3)).sum::<f32>() / 9.0
        };
        image = Image { data: (0..width * height).map(|k| around(k, &image)).collect(), ..image };
    }
    image.data.iter_mut().for_each(|v| *v = (0.5 + 3.0 * (*v - 0.5)).clamp(0.0, 1.0));
    image
}

/// Whether the object with this left edge covers a pixel.
fn covers(left: usize, x: usize, y: usize) -> bool {
    (left..left + SIDE).contains(&x) && (TOP..TOP + SIDE).contains(&y)
}

/// The wall with the object before it.
fn picture(left: usize) -> Image {
    let (mut image, object) = (pattern(SIZE[0], SIZE[1], 1), pattern(SIDE, SIDE, 2));
    for y in TOP..TOP + SIDE {
        for x in left..left + SIDE {
            image.pixel_mut(x, y)[0] = object.pixel(x - left, y - TOP)[0];
        }
    }
    image
}

fn of_set(image: &Image, set: &[Image], rule: &CovisibleOptions) -> Result<Seen, MetricError> {
    seen(image, set.len(), |k| Ok(set[k].clone()), rule)
}

/// Share of the pixels for which `of` holds that the mask has.
fn share(mask: &Image, of: impl Fn(usize, usize) -> bool) -> f64 {
    let places: Vec<usize> = (0..mask.data.len()).filter(|k| of(k % mask.width, k / mask.width)).collect();
    assert!(places.len() > 500, "{} pixels are too few for a share", places.len());
    places.iter().map(|k| f64::from(mask.data[*k])).sum::<f64>() / places.len() as f64
}

#[test]
fn what_an_object_hides_in_every_image_is_not_co_visible() {
    let set: Vec<Image> = (0..IMAGES).map(|k| picture(left_of(k))).collect();
    let test = picture(LEFT);
    let rule = CovisibleOptions::default();
    let needed = rule.needed(IMAGES);
    let shown = |x: usize, y: usize| (0..IMAGES).filter(|k| !covers(left_of(*k), x, y)).count() >= needed;
    let hidden = |x: usize, y: usize| !covers(LEFT, x, y) && !shown(x, y);
    // No pixel within 8 that some image hides, or that is the object.
    let clear = |x: usize, y: usize| {
        let near = |left: usize, right: usize| x + 8 < left || x >= right + 8 || y + 8 < TOP || y >= TOP + SIDE + 8;
        near(left_of(0), left_of(IMAGES - 1) + SIDE) && near(LEFT, LEFT + SIDE)
    };
    let mask = of_set(&test, &set, &rule).unwrap().mask(needed);
    let flow_only = CovisibleOptions { colors: false, ..rule };
    let by_flow = of_set(&test, &set, &flow_only).unwrap().mask(needed);
    let shares = [share(&mask, hidden), share(&by_flow, hidden), share(&mask, clear)];
    println!(
        "co-visible: {:.3} of the hidden wall ({:.3} by the flow alone), {:.3} of the clear wall",
        shares[0], shares[1], shares[2]
    );
    assert!(shares[0] <= 0.2 && shares[1] >= 0.8 && shares[2] >= 0.97, "{shares:?}");
}

#[test]
fn a_camera_and_things_at_rest_are_wholly_co_visible() {
    let image = picture(40);
    for colors in [true, false] {
        let rule = CovisibleOptions { colors, ..CovisibleOptions::default() };
        let all = of_set(&image, &vec![image.clone(); 6], &rule).unwrap();
        assert!(all.counts.iter().all(|n| *n == 6) && all.mask(rule.needed(6)).data.iter().all(|m| *m == 1.0));
        assert!(all.mask(7).data.iter().all(|m| *m == 0.0), "no more than there are");
    }
    // The second image of a camera at rest has other noise: of half a step of 8 bits here.
    let other = Image {
        data: image.data.iter().enumerate().map(|(k, v)| v + (k % 3) as f32 / 765.0).collect(),
        ..image.clone()
    };
    let pair = CovisibleOptions { more_than: 0, ..CovisibleOptions::default() };
    let mask = of_set(&image, &[other], &pair).unwrap().mask(1);
    assert!(mask.data.iter().all(|m| *m == 1.0));
}

/// The camera turns by six pixels: the left border is shown by the test image alone.
#[test]
fn what_leaves_the_frame_is_not_co_visible() {
    let wide = pattern(SIZE[0] + 6, SIZE[1], 3);
    let window = |first: usize| {
        let data = (0..SIZE[0] * SIZE[1]).map(|k| wide.pixel(first + k % SIZE[0], k / SIZE[0])[0]).collect();
        Image { width: SIZE[0], height: SIZE[1], channels: 1, data }
    };
    let pair = CovisibleOptions { more_than: 0, ..CovisibleOptions::default() };
    let mask = of_set(&window(0), &[window(6)], &pair).unwrap().mask(1);
    let shares = [share(&mask, |x, _| x < 6), share(&mask, |x, _| x >= 18)];
    println!("co-visible: {:.3} of what left the frame, {:.3} of what stayed", shares[0], shares[1]);
    assert!(shares[0] <= 0.15 && shares[1] >= 0.9, "{shares:?}");
}

#[test]
fn counts_do_not_depend_on_threads() {
    let set: Vec<Image> = (0..5).map(|k| picture(left_of(k))).collect();
    let run = |threads| in_pool(threads, || of_set(&picture(LEFT), &set, &CovisibleOptions::default()).unwrap());
    let one = run(1);
    assert!(one.counts.iter().any(|n| *n > 0) && one.counts.iter().any(|n| *n < 5));
    assert!(one == run(2) && one == run(7));
}

#[test]
fn bad_images_and_options_are_errors() {
    let (image, rule) = (noise(40, 30, 3, 0.0, 1.0, 1), CovisibleOptions::default());
    let error = |set: &[Image], rule: &CovisibleOptions| of_set(&image, set, rule).unwrap_err();
    assert!(matches!(error(&[noise(30, 40, 3, 0.0, 1.0, 2)], &rule), MetricError::Shape { .. }));
    assert!(matches!(error(&[noise(40, 30, 1, 0.0, 1.0, 2)], &rule), MetricError::Shape { .. }));
    let mut nan = image.clone();
    nan.data[7] = f32::NAN;
    assert!(matches!(error(&[nan], &rule), MetricError::NotFinite { .. }));
    let wrong = CovisibleOptions { slack: -1.0, ..rule };
    assert!(matches!(error(&[], &wrong), MetricError::Option { name: "slack", .. }));
    let wrong = CovisibleOptions { growth: f32::INFINITY, ..rule };
    assert!(matches!(error(&[], &wrong), MetricError::Option { name: "growth", .. }));
    let none = of_set(&image, &[], &rule).unwrap();
    assert_eq!((none.counts.len(), none.counts.iter().sum::<u32>()), (1200, 0), "no image sees anything");
    let full = MetricError::EmptyMask;
    assert_eq!(seen(&image, 3, |_| Err(full.clone()), &rule).unwrap_err(), full, "what the set says is passed on");
}
