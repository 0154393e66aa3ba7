// Numbers as unevaluated sums of two f32, about 46 bits: a pair (x, y) stands for x + y with |y| ≤ ulp(x)/2 (Dekker 1971, Knuth).
// WGSL lets a compiler reassociate, which would destroy the error terms; `opaque` hides a value from it.

fn opaque(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ view.zero.x);
}

// a + b exactly.
fn two_sum(a: f32, b: f32) -> vec2<f32> {
    let s = opaque(a + b);
    let t = opaque(s - a);
    let u = opaque(s - t);
    return vec2(s, opaque(a - u) + opaque(b - t));
}

// a + b exactly where |a| ≥ |b|.
fn quick_two_sum(a: f32, b: f32) -> vec2<f32> {
    let s = opaque(a + b);
    let t = opaque(s - a);
    return vec2(s, b - t);
}

// The upper twelve bits of the significand.
fn upper(a: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
}

// a b exactly.
fn two_prod(a: f32, b: f32) -> vec2<f32> {
    let p = opaque(a * b);
    let ah = upper(a);
    let bh = upper(b);
    let al = opaque(a - ah);
    let bl = opaque(b - bh);
    let e1 = opaque(opaque(ah * bh) - p);
    let e2 = opaque(e1 + opaque(ah * bl));
    let e3 = opaque(e2 + opaque(al * bh));
    return vec2(p, e3 + opaque(al * bl));
}

fn d_from(a: f32) -> vec2<f32> {
    return vec2(a, 0.0);
}

fn d_add(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let s = two_sum(a.x, b.x);
    let t = two_sum(a.y, b.y);
    let u = quick_two_sum(s.x, s.y + t.x);
    return quick_two_sum(u.x, u.y + t.y);
}

fn d_sub(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return d_add(a, -b);
}

fn d_mul(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let p = two_prod(a.x, b.x);
    return quick_two_sum(p.x, p.y + (a.x * b.y + a.y * b.x));
}

fn d_mul_f(a: vec2<f32>, b: f32) -> vec2<f32> {
    let p = two_prod(a.x, b);
    return quick_two_sum(p.x, p.y + a.y * b);
}

fn d_div(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let q = opaque(a.x / b.x);
    let r = d_sub(a, d_mul_f(b, q));
    let q2 = opaque(r.x / b.x);
    let r2 = d_sub(r, d_mul_f(b, q2));
    return d_add(quick_two_sum(q, q2), d_from(r2.x / b.x));
}

fn d_sqrt(a: vec2<f32>) -> vec2<f32> {
    if (!(a.x > 0.0)) {
        return vec2(0.0, 0.0);
    }
    let x = opaque(sqrt(a.x));
    let r = d_sub(a, two_prod(x, x));
    let half = 0.5 / x;
    let y = quick_two_sum(x, r.x * half);
    let r2 = d_sub(a, d_mul(y, y));
    return d_add(y, d_from(r2.x * half));
}

fn d_less(a: vec2<f32>, b: vec2<f32>) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

fn d_dot(a: array<vec2<f32>, 3>, b: array<vec2<f32>, 3>) -> vec2<f32> {
    return d_add(d_add(d_mul(a[0], b[0]), d_mul(a[1], b[1])), d_mul(a[2], b[2]));
}
