// Real spherical harmonics up to degree 3, in the order and signs of `gs_core::sh`.

const C0: f32 = 0.28209479;
const C1: f32 = 0.48860251;
const C2: array<f32, 5> = array(1.0925484, -1.0925484, 0.31539157, -1.0925484, 0.54627421);
const C3: array<f32, 7> =
    array(-0.59004359, 2.8906114, -0.45704580, 0.37317633, -0.45704580, 1.4453057, -0.59004359);

// Direction from the camera to a point, and the reciprocal distance; zeros where they coincide.
fn direction(mean: vec3<f32>) -> vec4<f32> {
    let d = (mean - view.position_h.xyz) - view.position_l.xyz;
    let big = max(max(abs(d.x), abs(d.y)), abs(d.z));
    if (!(big > 0.0)) {
        return vec4(0.0, 0.0, 0.0, 0.0);
    }
    let scaled = d / big;
    let inverse = 1.0 / sqrt(dot(scaled, scaled));
    return vec4(scaled * inverse, inverse / big);
}

fn basis(d: vec3<f32>, degree: u32) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    var out: array<f32, 16>;
    out[0] = C0;
    if (degree >= 1u) {
        out[1] = -C1 * y;
        out[2] = C1 * z;
        out[3] = -C1 * x;
    }
    if (degree >= 2u) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        out[4] = C2[0] * x * y;
        out[5] = C2[1] * y * z;
        out[6] = C2[2] * (2.0 * zz - xx - yy);
        out[7] = C2[3] * x * z;
        out[8] = C2[4] * (xx - yy);
        if (degree >= 3u) {
            let ring = 4.0 * zz - xx - yy;
            out[9] = C3[0] * y * (3.0 * xx - yy);
            out[10] = C3[1] * x * y * z;
            out[11] = C3[2] * y * ring;
            out[12] = C3[3] * z * (2.0 * zz - 3.0 * (xx + yy));
            out[13] = C3[4] * x * ring;
            out[14] = C3[5] * z * (xx - yy);
            out[15] = C3[6] * x * (xx - 3.0 * yy);
        }
    }
    return out;
}

// Cotangent of the direction, its entries taken as independent.
fn basis_backward(d: vec3<f32>, degree: u32, g: array<f32, 16>) -> vec3<f32> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    var out = vec3(0.0, 0.0, 0.0);
    if (degree >= 1u) {
        out = C1 * vec3(-g[3], -g[1], g[2]);
    }
    if (degree >= 2u) {
        let g4 = C2[0] * g[4];
        let g5 = C2[1] * g[5];
        let g6 = 2.0 * C2[2] * g[6];
        let g7 = C2[3] * g[7];
        let g8 = 2.0 * C2[4] * g[8];
        out += vec3(g4 * y - g6 * x + g7 * z + g8 * x, g4 * x + g5 * z - g6 * y - g8 * y, g5 * y + 2.0 * g6 * z + g7 * x);
    }
    if (degree >= 3u) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        let xy = x * y;
        let k0 = C3[0] * g[9];
        let k1 = C3[1] * g[10];
        let k2 = C3[2] * g[11];
        let k3 = C3[3] * g[12];
        let k4 = C3[4] * g[13];
        let k5 = C3[5] * g[14];
        let k6 = C3[6] * g[15];
        out.x += 6.0 * k0 * xy + k1 * y * z - 2.0 * k2 * xy - 6.0 * k3 * x * z + k4 * (4.0 * zz - 3.0 * xx - yy)
            + 2.0 * k5 * x * z + 3.0 * k6 * (xx - yy);
        out.y += 3.0 * k0 * (xx - yy) + k1 * x * z + k2 * (4.0 * zz - xx - 3.0 * yy) - 6.0 * k3 * y * z
            - 2.0 * k4 * xy - 2.0 * k5 * y * z - 6.0 * k6 * xy;
        out.z += k1 * xy + 8.0 * k2 * y * z + 3.0 * k3 * (2.0 * zz - xx - yy) + 8.0 * k4 * x * z + k5 * (xx - yy);
    }
    return out;
}

// Colour before the clamp at zero of the coefficients that start at `first`.
fn color_of(basis: array<f32, 16>, first: u32, count: u32) -> vec3<f32> {
    var rgb = vec3(0.5, 0.5, 0.5);
    for (var k = 0u; k < count; k++) {
        let at = first + 3u * k;
        rgb += basis[k] * vec3(colors[at], colors[at + 1u], colors[at + 2u]);
    }
    return rgb;
}
