// Workgroups are dispatched in rows, since one dimension holds 65 535 at most.

// Position of a workgroup over all rows.
fn workgroup_index(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.y * groups.x + group.x;
}
