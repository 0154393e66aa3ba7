// What the kernels of a cloud know of it.
struct Cloud {
    splats: u32,
    rendered: u32,  // values of a colour that are rendered
    stored: u32,    // values of a colour that there are
    moves: u32,     // which offsets there are: 1 of means, 2 of scales, 4 of quaternions
    rules: u32,     // how they act: 1: scale + ds, else scale exp(ds); 2: quat + |quat| dr, else quat + dr; 4: scales
                    // have no gradient
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(0) var<uniform> cloud: Cloud;

const MEANS: u32 = 1u;
const SCALES: u32 = 2u;
const QUATS: u32 = 4u;
const SCALES_ADD: u32 = 1u;
const QUATS_UNIT: u32 = 2u;
const KEEPS_SIZES: u32 = 4u;

fn moves(column: u32) -> bool {
    return (cloud.moves & column) != 0u;
}

fn has_rule(rule: u32) -> bool {
    return (cloud.rules & rule) != 0u;
}

// Length of a quaternion; squares neither overflow nor vanish.
fn length_of(q: vec4<f32>) -> f32 {
    let big = max(max(abs(q.x), abs(q.y)), max(abs(q.z), abs(q.w)));
    if (big == 0.0) {
        return 0.0;
    }
    let scaled = q / big;
    return big * sqrt(dot(scaled, scaled));
}
