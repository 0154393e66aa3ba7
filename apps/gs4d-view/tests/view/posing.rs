//! A filmed person in poses of the user's.

use gs_method_texel::Dut;
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_view::pose::{Posing, inputs, joints};
use std::sync::Arc;

#[test]
fn its_own_pose_changes_nothing_and_a_turned_arm_moves_alone() {
    let template = "builtin:person".to_owned();
    let options = AvatarOptions { template, size: 32, frames: 3, rings: 1, points: 200, ..AvatarOptions::default() };
    let film = Arc::new(avatar::generate(&options).unwrap());
    let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
    let trainer = Trainer::new(gs_methods::registry(), film.clone(), "dut", &config, TrainOptions::default()).unwrap();
    let method = trainer.model();
    let figure = method.concrete::<Dut>().expect("a person");
    let filmed = method.splats(&Timestamp::normalised(0.0), &film.train[0].camera).unwrap();
    let posed = |posing: &Posing| figure.posed(&Timestamp::normalised(0.0), &posing.of(figure, 0.0).unwrap()).unwrap();
    assert_eq!(posed(&Posing::default()), filmed);

    let names = joints(figure);
    let arm = names.as_array().unwrap().iter().position(|n| n == "left upper arm").unwrap() as u32;
    let turned = posed(&Posing { from: None, turns: vec![(arm, [0.0, 0.0, 1.0])] });
    let moved: Vec<f32> = turned.means.iter().zip(&filmed.means).map(|(a, b)| a.distance(*b)).collect();
    let (far, still) = (moved.iter().filter(|d| **d > 0.05).count(), moved.iter().filter(|d| **d == 0.0).count());
    assert!(far * 50 > moved.len() && still * 2 > moved.len(), "{far} and {still} of {}", moved.len());
    assert_eq!((&turned.color, &turned.opacities), (&filmed.color, &filmed.opacities), "looks stay");

    let borrowed = posed(&Posing { from: Some(1.0), turns: Vec::new() });
    assert!(borrowed.means != filmed.means && borrowed.color == filmed.color);
    assert_eq!(
        (&inputs(figure, 0.0)["frame"], inputs(figure, 0.0)["images"].as_array().unwrap().len()),
        (&0.into(), 4)
    );
    assert!(Posing { from: None, turns: vec![(9999, [0.0; 3])] }.of(figure, 0.0).is_err());
}
