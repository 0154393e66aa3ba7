use super::*;
use gs_core::Rng;

fn encoding(coding: Coding, columns: usize, group: usize, deflate: bool) -> Encoding {
    Encoding { coding, columns, group, deflate }
}

fn values(n: usize) -> Vec<f32> {
    let mut rng = Rng::new(1, "packed", 0, n as u64);
    (0..n).map(|i| rng.normal() * 10f32.powi(i as i32 % 3)).collect()
}

fn round_trip(values: &[f32], encoding: &Encoding) -> Vec<f32> {
    unpack(&pack(values, encoding), MAX_VALUES).unwrap()
}

fn lattice(step: f32) -> Coding {
    Coding::Lattice { step, exact: false }
}

#[test]
fn errors_stay_within_half_a_step() {
    for n in [0, 1, 3, 12, 300, 1203] {
        let values = values(n);
        for (columns, group) in [(1, 0), (3, 0), (3, 7), (1, 256), (7, 0)] {
            for deflate in [false, true] {
                let back = |coding| round_trip(&values, &encoding(coding, columns, group, deflate));
                assert_eq!(back(Coding::F32), values);
                for (v, w) in values.iter().zip(back(Coding::F16)) {
                    assert!((v - w).abs() <= v.abs() / 2048.0 + 3e-8, "{v} {w}");
                }
                let span = values.iter().fold(0.0f32, |m, v| m.max(v.abs())) * 2.0;
                for (coding, levels) in [(Coding::Affine8, 255.0), (Coding::Affine16, 65_535.0)] {
                    for (v, w) in values.iter().zip(back(coding)) {
                        assert!((v - w).abs() <= 0.5001 * span / levels, "{coding:?} {v} {w}");
                    }
                }
            }
        }
    }
}

#[test]
fn each_column_and_group_has_its_own_scale() {
    // Three columns of very different sizes; the second half of the rows is a thousand times as large.
    let at = |i: usize| [1e-3, 1.0, 1e3][i % 3] * (i as f32).sin() * if i < 300 { 1.0 } else { 1e3 };
    let values: Vec<f32> = (0..600).map(at).collect();
    let back = round_trip(&values, &encoding(Coding::Affine8, 3, 100, true));
    for (i, (v, w)) in values.iter().zip(&back).enumerate() {
        let size = [1e-3, 1.0, 1e3][i % 3] * if i < 300 { 1.0 } else { 1e3 };
        assert!((v - w).abs() <= size / 250.0, "{i}: {v} {w}");
    }
    // Steps of one code: 600 values, 6 groups of 8 bytes, the head.
    assert_eq!(pack(&values, &encoding(Coding::Affine8, 3, 100, false)).len(), 600 + 6 * 8 + HEAD);
}

#[test]
fn constants_and_extremes_survive() {
    let affine = encoding(Coding::Affine8, 1, 0, false);
    assert_eq!(round_trip(&[0.3; 50], &affine), [0.3; 50]);
    assert_eq!(round_trip(&[-1e30, 0.0, 1e30], &affine)[0], -1e30);
    for wild in [vec![f32::MAX, -1.0], vec![f32::NAN, 1.0], vec![f32::INFINITY]] {
        for coding in [Coding::F16, Coding::Affine8, Coding::Affine16, lattice(0.1)] {
            let back = round_trip(&wild, &encoding(coding, 1, 0, true));
            assert_eq!(
                back.iter().map(|v| v.to_bits()).collect::<Vec<_>>(),
                wild.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
            );
        }
    }
}

#[test]
fn cells_of_a_lattice_come_back_exactly() {
    let mut rng = Rng::new(2, "packed", 0, 0);
    for step in [0.01f32, 1.0 / 3.0, 2e-5] {
        let values: Vec<f32> =
            (0..3000).map(|_| ((f64::from(rng.below(1_000_000)) - 4e5) * f64::from(step)) as f32).collect();
        let packed = pack(&values, &encoding(lattice(step), 3, 0, true));
        assert_eq!(packed[0], 4);
        assert_eq!(unpack(&packed, MAX_VALUES).unwrap(), values);
        assert!(packed.len() < 3 * values.len(), "{} bytes", packed.len());
    }
    // A value off the lattice: no lattice.
    let off = [0.01, 0.02, 0.0251];
    assert_eq!(pack(&off, &encoding(lattice(0.01), 3, 0, false))[0], 3);
    let exact = pack(&off, &encoding(Coding::Lattice { step: 0.01, exact: true }, 3, 0, false));
    assert_eq!((exact[0], unpack(&exact, 3).unwrap()), (0, off.to_vec()), "no value is rounded");
}

/// Packed tensors of every encoding.
fn samples() -> Vec<Vec<u8>> {
    let values: Vec<f32> = (0..60).map(|i| 0.25 * i as f32).collect();
    let codings = [Coding::F32, Coding::F16, Coding::Affine8, Coding::Affine16, lattice(0.25)];
    let both = codings.into_iter().flat_map(|c| [(c, false), (c, true)]);
    both.map(|(coding, deflate)| pack(&values, &encoding(coding, 3, 0, deflate))).collect()
}

#[test]
fn cut_payloads_are_refused() {
    for whole in samples() {
        for cut in 0..whole.len() {
            assert!(
                unpack(&whole[..cut], MAX_VALUES).is_err(),
                "encoding {}, cut at {cut} of {}",
                whole[0],
                whole.len()
            );
        }
    }
}

#[test]
fn changed_payloads_never_do_harm() {
    let mut rng = Rng::new(3, "packed", 0, 0);
    for whole in samples() {
        for _ in 0..3000 {
            let mut bad = whole.clone();
            for _ in 0..1 + rng.below(3) {
                let at = rng.below(bad.len() as u32) as usize;
                bad[at] = rng.below(256) as u8;
            }
            if let Ok(values) = unpack(&bad, 1 << 16) {
                assert!(values.len() <= 1 << 16);
            }
        }
    }
}

#[test]
fn sizes_and_scales_that_lie_are_told() {
    let sample = |code: usize| samples()[2 * code].clone();
    let mut many = sample(2);
    many[10..18].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(unpack(&many, MAX_VALUES).unwrap_err().contains("at most"));
    many[10..18].copy_from_slice(&63u64.to_le_bytes());
    assert!(unpack(&many, MAX_VALUES).unwrap_err().contains("are needed"));
    let mut columns = sample(2);
    columns[2..6].copy_from_slice(&0u32.to_le_bytes());
    assert!(unpack(&columns, MAX_VALUES).unwrap_err().contains("0 columns"));
    let mut unknown = sample(0);
    unknown[0] = 9;
    assert!(unpack(&unknown, MAX_VALUES).unwrap_err().contains("unknown encoding 9"));
    for (low, step) in [(f32::NAN, 1.0), (0.0, f32::NAN), (f32::INFINITY, 0.0), (0.0, -1.0), (1e38, 1e38)] {
        let mut scale = sample(2);
        scale[HEAD..HEAD + 4].copy_from_slice(&low.to_le_bytes());
        scale[HEAD + 4..HEAD + 8].copy_from_slice(&step.to_le_bytes());
        assert!(unpack(&scale, MAX_VALUES).unwrap_err().contains("no range of finite values"), "{low} {step}");
    }
    for step in [f32::NAN, 0.0, -1.0, f32::INFINITY] {
        let mut lattice = sample(4);
        lattice[HEAD..HEAD + 4].copy_from_slice(&step.to_le_bytes());
        assert!(unpack(&lattice, MAX_VALUES).unwrap_err().contains("lattice of step"));
    }
    // A bomb: few bytes that say they are many zeros.
    let zeros = pack(&vec![0.0; 1 << 20], &encoding(Coding::F32, 1, 0, true));
    assert!(zeros.len() < 8192 && unpack(&zeros, 1000).unwrap_err().contains("at most 1000"));
}

#[test]
fn a_file_holds_no_more_values_than_its_bytes_allow() {
    let zeros = vec![0.0; 4 << 20];
    let tensors: Vec<(String, Vec<f32>)> = vec![("a".into(), zeros.clone()), ("b".into(), vec![1.0; 3])];
    let encodings = [encoding(Coding::F16, 1, 0, true), encoding(Coding::F32, 1, 0, false)];
    let mut file = Vec::new();
    super::super::container::write_packed(&mut file, b"{}", &tensors, &encodings).unwrap();
    assert!(file.len() as u64 >= (4 << 20) / VALUES_PER_BYTE - FREE_VALUES / VALUES_PER_BYTE, "{}", file.len());
    let Ok(read) = super::super::container::read(&mut &file[..], file.len() as u64) else { panic!("refused") };
    assert_eq!(read.tensors, tensors);
    // The same values in as few bytes as deflate needs are not believed.
    let payload = pack(&zeros, &encodings[0]);
    assert!(payload.len() < 20_000);
    assert!(unpack(&payload, max_values(payload.len() as u64)).unwrap_err().contains("at most"));
}
