//! Files that claim, or inflate to, far more than they hold.

use crate::guarded;
use crate::seeds;
use gs_core::io::{IoError, Limits, glb, npy, parse_cameras, ply, spz};

const COUNTS: [&str; 8] = [
    "2147483648",
    "4294967295",
    "9223372036854775808",
    "18446744073709551615",
    "18446744073709551616",
    "-1",
    "-9223372036854775808",
    "1e18",
];

fn ply(bytes: &[u8]) -> Result<(), IoError> {
    ply::read(bytes, "b.ply", &Limits::default()).map(|_| ())
}

fn cameras(bytes: &[u8]) -> Result<(), IoError> {
    parse_cameras(bytes, "b.json", &Limits::default()).map(|_| ())
}

fn spz(bytes: &[u8]) -> Result<(), IoError> {
    spz::read(bytes, "b.spz", &Limits::default()).map(|_| ())
}

fn refused(what: &str, bytes: &[u8], read: fn(&[u8]) -> Result<(), IoError>) -> String {
    guarded(what, bytes, read).expect_err(what).to_string()
}

#[test]
fn ply_counts() {
    for text in [seeds::ply_ascii(2, 1), seeds::ply_binary(2, 3)] {
        let header_end = text.windows(10).position(|w| w == b"end_header").expect("header");
        let header = String::from_utf8_lossy(&text[..header_end]).into_owned();
        for count in COUNTS {
            let with =
                |from: &str, to: String| [header.replacen(from, &to, 1).as_bytes(), &text[header_end..]].concat();
            refused(count, &with("vertex 2", format!("vertex {count}")), ply);
            // Before the vertices: an element whose size overflows, one with a list, one without any property.
            let junk = format!("element junk {count}\nproperty double d\nelement vertex");
            refused(count, &with("element vertex", junk), ply);
            let list = format!("element faces {count}\nproperty list uchar int i\nelement vertex");
            refused(count, &with("element vertex", list), ply);
            let bytes = with("vertex 2", format!("vertex 2\nproperty list uint double {count}"));
            refused(count, &bytes, ply);
        }
    }
    let properties: String = (0..50_000).map(|i| format!("property double p{i}\n")).collect();
    let wide = format!("ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\n{properties}end_header\n");
    refused("wide rows", wide.as_bytes(), ply);
    let endless = ["ply\nformat ascii 1.0\n", &"comment x\n".repeat(300_000)].concat();
    assert!(refused("endless header", endless.as_bytes(), ply).contains("does not end"));
}

/// Samplers that all take the same bytes, one for each of many nodes.
#[test]
fn glb_key_frames() {
    let (keys, samplers) = (20_000usize, 400usize);
    let times: Vec<u8> = (0..keys).flat_map(|k| (k as f32).to_le_bytes()).collect();
    let values: Vec<u8> = (0..keys).flat_map(|_| [0.0f32, 0.0, 0.0, 1.0]).flat_map(f32::to_le_bytes).collect();
    let one = [0.0f32, 0.0, 0.0, 1.0].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let binary = [&one[..], &times, &values].concat();
    let own = |name: &str| format!("\"KHR_gaussian_splatting:{name}\"");
    let named = |name: &str, accessor: usize| format!(", {}: {accessor}", own(name));
    let attributes = "\"POSITION\": 0".to_owned()
        + &[("ROTATION", 1), ("SCALE", 0), ("OPACITY", 2), ("SH_DEGREE_0_COEF_0", 0)]
            .map(|(n, a)| named(n, a))
            .concat();
    let accessor = |view: usize, count: usize, kind: &str| {
        format!("{{\"bufferView\": {view}, \"componentType\": 5126, \"count\": {count}, \"type\": \"{kind}\"}}")
    };
    let accessors = [
        accessor(0, 1, "VEC3"),
        accessor(0, 1, "VEC4"),
        accessor(0, 1, "SCALAR"),
        accessor(1, keys, "SCALAR"),
        accessor(2, keys, "VEC4"),
    ];
    let view = |at: usize, length: usize| format!("{{\"buffer\": 0, \"byteOffset\": {at}, \"byteLength\": {length}}}");
    let views = [view(0, 16), view(16, times.len()), view(16 + times.len(), values.len())];
    let list = |one: &dyn Fn(usize) -> String| (0..samplers).map(one).collect::<Vec<_>>().join(", ");
    let nodes = list(&|_| "{\"mesh\": 0}".to_owned());
    let channels = list(&|k| format!("{{\"sampler\": {k}, \"target\": {{\"node\": {k}, \"path\": \"rotation\"}}}}"));
    let all = list(&|_| "{\"input\": 3, \"output\": 4}".to_owned());
    let json = format!(
        "{{\"asset\": {{\"version\": \"2.0\"}}, \"buffers\": [{{\"byteLength\": {}}}], \"bufferViews\": [{}], \"accessors\": [{}], \
         \"meshes\": [{{\"primitives\": [{{\"mode\": 0, \"attributes\": {{{attributes}}}, \"extensions\": {{\"KHR_gaussian_splatting\": {{}}}}}}]}}], \
         \"nodes\": [{nodes}], \"animations\": [{{\"channels\": [{channels}], \"samplers\": [{all}]}}]}}",
        binary.len(),
        views.join(", "),
        accessors.join(", ")
    );
    let read =
        |bytes: &[u8]| glb::read_scene(bytes, "b.glb", &Limits { max_expansion: 16, ..Limits::default() }).map(|_| ());
    assert!(refused("400 times 20 000 key frames", &glb_file(&json, &binary), read).contains("decoded bytes"));
    let lists = format!("[{}0]", "[],".repeat(200_000));
    assert!(refused("200 000 lists", &glb_file(&lists, &[]), read).contains("decoded bytes"));
}

/// A binary glTF of two chunks.
fn glb_file(json: &str, binary: &[u8]) -> Vec<u8> {
    let padded = |bytes: &[u8], with: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), with);
        bytes
    };
    let (json, binary) = (padded(json.as_bytes(), b' '), padded(binary, 0));
    let word = |v: usize| u32::try_from(v).expect("small").to_le_bytes();
    [
        &b"glTF"[..],
        &word(2),
        &word(28 + json.len() + binary.len()),
        &word(json.len()),
        b"JSON",
        &json,
        &word(binary.len()),
        b"BIN\0",
        &binary,
    ]
    .concat()
}

#[test]
fn npy_shapes() {
    let read = |bytes: &[u8]| npy::read(bytes, "b.npy", &Limits::default()).map(|_| ());
    for shape in
        ["4294967296,", "65536, 65536, 65536, 65536", "18446744073709551615, 2", "18446744073709551616,", "-1, -1"]
    {
        let dict = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({shape}), }}");
        let bytes =
            [b"\x93NUMPY\x01\x00".as_slice(), &(dict.len() as u16).to_le_bytes(), dict.as_bytes(), &[0; 8]].concat();
        refused(shape, &bytes, read);
    }
    let many = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", "1, ".repeat(20_000));
    let bytes =
        [b"\x93NUMPY\x01\x00".as_slice(), &(many.len() as u16).to_le_bytes(), many.as_bytes(), &[0; 4]].concat();
    guarded("many sides", &bytes, read).expect("one value with many sides of 1");
    refused("header length", b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", read);
}

#[test]
fn spz_counts_and_gzip_bombs() {
    let header = |count: u32, degree: u8| {
        [b"NGSP\x03\x00\x00\x00".as_slice(), &count.to_le_bytes(), &[degree, 12, 0, 0]].concat()
    };
    for count in [1 << 31, u32::MAX, 1 << 24, 1 << 20] {
        for degree in [0, 3] {
            refused("count alone", &seeds::gzip(&header(count, degree)), spz);
        }
    }
    // 200 MB of zeros in 200 kB: as many splats as that holds, and one splat with the rest behind it.
    let zeros = vec![0u8; 200_000_000];
    let claim = |count| seeds::gzip(&[header(count, 0), zeros.clone()].concat());
    assert!(refused("inflates", &claim(10_000_000), spz).contains("max_expansion"));
    assert!(refused("inflates behind", &claim(1), spz).contains("bytes follow"));
}

#[test]
fn json_bombs() {
    for text in [
        "[".repeat(1_000_000),
        format!("[{}", "{},".repeat(1_000_000)),
        format!("{{\"frames\":[{}{{}}]}}", "{},".repeat(1_000_000)),
        format!("[{{\"position\":[{}1]}}]", "1,".repeat(1_000_000)),
        format!("[{{\"world_to_camera\":[{}[]]}}]", "[0,0,0,1],".repeat(300_000)),
        format!("[{{\"x\":{}}}]", "[".repeat(1_000_000)),
        format!("{{\"w\":8,\"h\":8,\"fl_x\":8,\"frames\":[{}0]}}", "0,".repeat(1_000_000)),
        format!("[{{\"{}\":1}}]", "k".repeat(1_000_000)),
    ] {
        refused(&text[..30], text.as_bytes(), cameras);
    }
    // The densest good file: memory follows the cameras.
    let entry = r#"{"fx":1,"fy":1,"width":1,"height":1,"position":[0,0,0],"rotation":[[1,0,0],[0,1,0],[0,0,1]]},"#;
    let text = format!("[{}]", entry.repeat(100_000).trim_end_matches(','));
    guarded("many cameras", text.as_bytes(), cameras).expect("good");
}

#[cfg(feature = "images")]
#[test]
fn png_sides() {
    let read = |bytes: &[u8]| gs_core::io::images::decode_rgba8(bytes, "b.png", &Limits::default()).map(|_| ());
    for side in [32_767u32, 32_768, 60_000, 1 << 31, u32::MAX, 0] {
        for (width, height) in [(side, side), (side, 1), (1, side)] {
            let mut bytes = seeds::png();
            bytes[16..20].copy_from_slice(&width.to_be_bytes());
            bytes[20..24].copy_from_slice(&height.to_be_bytes());
            refused(&format!("png {width}x{height}"), &seeds::png_checksums(&bytes), read);
        }
    }
}

#[cfg(feature = "exr")]
#[test]
fn exr_windows_and_channels() {
    let read = |bytes: &[u8]| gs_core::io::exr::read(bytes, "b.exr", &Limits::default()).map(|_| ());
    let good = seeds::exr();
    for window in ["dataWindow", "displayWindow"] {
        let at = good.windows(window.len()).position(|w| w == window.as_bytes()).expect("attribute");
        let corner = at + window.len() + 1 + "box2i".len() + 1 + 4 + 8;
        for side in [20_000i32, 32_767, 65_535, 1 << 24, i32::MAX, i32::MIN] {
            let mut bytes = good.clone();
            for edge in [corner, corner + 4] {
                bytes[edge..edge + 4].copy_from_slice(&side.to_le_bytes());
            }
            refused(&format!("{window} {side}"), &bytes, read);
        }
    }
}
