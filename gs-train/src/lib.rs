//! Work in progress.

pub mod adam;
pub mod bench;
pub mod checkpoint;
pub mod compare;
pub mod config;
pub mod data;
pub mod density;
pub mod evaluate;
pub mod guard;
pub mod inspect;
pub mod loss;
pub mod methods;
pub mod moment;
pub mod report;
pub mod run;
pub mod schedule;
pub mod synth;
pub mod trainer;
