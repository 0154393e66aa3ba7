// First and one past the last slot of each tile in the sorted entries. Tiles without entries keep the zeros they were given.

@group(0) @binding(0) var<storage, read> count: array<u32>;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2<u32>>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let slot = 256u * workgroup_index(group, groups) + lane;
    let n = min(count[arrayLength(&count) - 1u], arrayLength(&tiles));
    if (slot >= n) {
        return;
    }
    let tile = tiles[slot];
    if (slot == 0u || tiles[slot - 1u] != tile) {
        ranges[tile].x = slot;
    }
    if (slot + 1u == n || tiles[slot + 1u] != tile) {
        ranges[tile].y = slot + 1u;
    }
}
