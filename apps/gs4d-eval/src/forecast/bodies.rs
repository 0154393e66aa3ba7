//! Rigid bodies of a forecast, on the clock of the data.

use super::Clock;
use gs_train::capabilities::RigidBody;
use serde::Serialize;

/// A rigid body whose velocity, spin and acceleration are per unit of time of the data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TimedBody {
    /// The body: `velocity` and `spin` per unit of time, `acceleration` per unit of time squared.
    #[serde(flatten)]
    pub body: RigidBody,
    /// That unit of time: `s`, or `sequence` where the data have no clock.
    pub unit: &'static str,
}

impl TimedBody {
    /// A body whose velocity, spin and acceleration are per unit of normalised time.
    pub fn of(body: RigidBody, clock: Option<Clock>) -> Self {
        let (unit, rate) = Clock::unit(clock);
        let [velocity, spin] = [body.velocity, body.spin].map(|v| v.map(|v| v / rate));
        let acceleration = body.acceleration.map(|v| v / (rate * rate));
        Self { body: RigidBody { velocity, spin, acceleration, ..body }, unit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sequence of two seconds.
    #[test]
    fn bodies_move_on_the_clock_of_the_data() {
        let body = RigidBody {
            path: "throw",
            splats: 3,
            centroid: [1.0, 2.0, 3.0],
            velocity: [4.0, 0.0, -2.0],
            spin: [0.0, 6.0, 0.0],
            acceleration: [0.0, 0.0, -8.0],
            frames: 7,
            deviations: vec![0.5],
        };
        let timed = TimedBody::of(body.clone(), Some(Clock { start: 5.0, rate: 2.0 }));
        let [velocity, spin, acceleration] = [[2.0, 0.0, -1.0], [0.0, 3.0, 0.0], [0.0, 0.0, -2.0]];
        assert_eq!(timed, TimedBody { body: RigidBody { velocity, spin, acceleration, ..body.clone() }, unit: "s" });
        let json = serde_json::to_value(&timed).unwrap();
        assert_eq!((&json["path"], &json["unit"], &json["velocity"][0]), (&"throw".into(), &"s".into(), &2.0.into()));
        assert_eq!(TimedBody::of(body.clone(), None), TimedBody { body, unit: "sequence" });
    }
}
