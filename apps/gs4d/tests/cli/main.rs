//! The built program, called as a user calls it: every verb on tiny generated inputs, exit codes, JSON, refusals.

mod avatar;
mod captures;
mod compact;
mod compare;
mod contest;
mod doctor;
mod export;
mod folders;
mod future;
mod glmd;
mod guide;
mod hostile;
mod kill;
mod lab;
mod moved;
mod pipes;
mod pose;
mod render;
mod runs;
mod segment;
mod support;
mod sweep;
mod usage;
mod view;
