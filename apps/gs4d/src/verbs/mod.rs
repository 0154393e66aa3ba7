//! One file per verb.

pub mod bench;
pub mod compact;
pub mod compare;
pub mod config;
pub mod contest;
pub mod continual;
pub mod demo;
pub mod doctor;
pub mod eval;
pub mod export;
pub mod forecast;
pub mod glmd;
pub mod init;
pub mod inspect;
pub mod jobs;
pub mod lab;
pub mod methods;
mod player;
pub mod pose;
pub mod render;
pub mod resume;
pub mod segment;
pub mod shell;
pub mod sweep;
pub mod synth;
pub mod train;
pub mod view;
