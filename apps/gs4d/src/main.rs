//! The command line of gs4d.
fn main() {}
