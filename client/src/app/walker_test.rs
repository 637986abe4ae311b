use super::*;
use crate::app::collision::tests as collision;
use collision::{plate, wall};
use ldi_protocol::Aabb;
use proptest::prelude::*;

const FOOT: f64 = 0.5;

/// A volume of columns of half a metre and layers of 0.1 m above the floor of each column (None: no
/// floor), for eyes at 1.6 m.
fn volume(columns: [u32; 2], floor_m: impl Fn(f64, f64) -> Option<f64>) -> WalkVolume {
    let origin = DVec3::new(0.0, 0.0, 0.0);
    let runs: Vec<Vec<[u16; 2]>> = (0..columns[0] * columns[1])
        .map(|c| {
            let (x, z) = (f64::from(c % columns[0]) * FOOT, f64::from(c / columns[0]) * FOOT);
            // As on the server, all floors in and beside the column count.
            let near = [-0.1, 0.25, 0.6].map(|dx| [-0.1, 0.25, 0.6].map(|dz| floor_m(x + dx, z + dz)));
            let middle = floor_m(x + 0.25, z + 0.25)?;
            let floors = near.into_iter().flatten().flatten().filter(|f| (f - middle).abs() < 1.0);
            let (low, high) = floors.fold((middle, middle), |(l, h), f| (l.min(f), h.max(f)));
            let layer = |y: f64| (y * 10.0).round() as u16;
            Some([layer(low + 1.1), layer(high + 2.0)])
        })
        .map(|run| run.into_iter().collect())
        .collect();
    let cut =
        Aabb { min: DVec3::ZERO, max: DVec3::new(f64::from(columns[0]) * FOOT, 0.0, f64::from(columns[1]) * FOOT) };
    WalkVolume::new(origin, FOOT, 0.1, columns, &runs, &cut).unwrap()
}

/// Two rooms of 6 x 6 m, joined by a door 1 m wide at z = 2.5 .. 3.5.
fn rooms() -> WalkVolume {
    volume([26, 12], |x, z| {
        let wall = (6.0..7.0).contains(&x) && !(2.5..3.5).contains(&z);
        let inside = (0.0..13.0).contains(&x) && (0.0..6.0).contains(&z);
        (inside && !wall).then_some(0.0)
    })
}

/// A floor, a flight of 17 steps of 0.28 x 0.18 m along x, and the floor above it.
fn stairs() -> WalkVolume {
    volume([30, 4], |x, _| Some((((x - 4.0) / 0.28).floor().clamp(0.0, 17.0)) * 0.18))
}

fn walker(v: &WalkVolume, x: f64, z: f64, yaw_deg: f64) -> Walker {
    Walker::new(Pose { position: DVec3::new(x, 1.6, z), yaw_deg, pitch_deg: 0.0 }, Some(v), false, 60.0)
}

const AHEAD: Intent = Intent { forward: 1.0, right: 0.0, up: 0.0, turn: 0.0, tilt: 0.0, run: false };

/// A course with turns, side steps, runs and stops, which change every second; updated `rate` times
/// per second.
fn course(v: &WalkVolume, start: (f64, f64), rate: u32) -> Vec<DVec3> {
    let mut w = walker(v, start.0, start.1, -90.0);
    let seconds = [
        (0.0, AHEAD),
        (20.0, Intent { run: true, ..AHEAD }),
        (-65.0, Intent { right: 0.7, ..AHEAD }),
        (0.0, Intent::default()),
        (150.0, AHEAD),
        (45.0, Intent { run: true, right: -1.0, ..AHEAD }),
        (-100.0, Intent { forward: -1.0, ..AHEAD }),
        (0.0, Intent { turn: 1.0, ..AHEAD }),
    ];
    let mut places = Vec::new();
    for (turn, intent) in seconds {
        w.turn(turn, 0.0);
        for _ in 0..rate {
            w.advance(Some(v), &intent, 1.0 / f64::from(rate));
        }
        places.push(w.pose().position);
    }
    places
}

#[test]
fn a_second_of_walking_is_1_4_m_less_the_start() {
    let v = rooms();
    let mut w = walker(&v, 0.5, 1.0, -90.0);
    (0..60).for_each(|_| w.advance(Some(&v), &AHEAD, 1.0 / 60.0));
    let expected = 0.5 + WALK_M_PER_S * (1.0 - RESPONSE_S * (1.0 - (-1.0 / RESPONSE_S).exp()));
    assert!((w.pose().position.x - expected).abs() < 1e-9, "{:?} {expected}", w.pose());
    w.change_speed(1.0);
    assert!((w.speed_m_per_s() - 1.61).abs() < 1e-9);
}

#[test]
fn the_same_way_at_30_and_at_144_updates_per_second() {
    for (v, start) in [(rooms(), (1.0, 1.0)), (rooms(), (5.0, 3.0)), (stairs(), (3.0, 1.0))] {
        let fine = course(&v, start, 144);
        for rate in [30, 60, 75] {
            for (a, b) in course(&v, start, rate).iter().zip(&fine) {
                assert!(a.distance(*b) < 0.05, "{rate} per second from {start:?}: {a} instead of {b}");
            }
        }
        // The course must be long for the bound to be meaningful.
        assert!(fine.windows(2).map(|p| p[0].distance(p[1])).sum::<f64>() > 4.0);
    }
}

#[test]
fn walls_are_slid_along() {
    let v = rooms();
    // 45 degrees toward the wall at z = 0: the speed along the wall is the speed over the square
    // root of two.
    let mut w = walker(&v, 1.0, 0.2, -45.0);
    (0..120).for_each(|_| w.advance(Some(&v), &AHEAD, 1.0 / 60.0));
    let p = w.pose().position;
    assert!(p.z < 0.01 && (p.x - 1.0 - 2.0 * 1.4 * 0.5f64.sqrt()).abs() < 0.15, "{p}");
    // Straight into a corner.
    (0..300).for_each(|_| w.advance(Some(&v), &AHEAD, 1.0 / 60.0));
    let p = w.pose().position;
    assert!((p.x - 6.0).abs() < 0.01 && p.z < 0.01, "{p}");
}

#[test]
fn a_door_is_passed_by_sliding_into_it() {
    let v = rooms();
    // Against the wall beside the door, nearly along it.
    let mut w = walker(&v, 5.5, 1.0, -90.0 - 60.0);
    (0..240).for_each(|_| w.advance(Some(&v), &AHEAD, 1.0 / 60.0));
    assert!(w.pose().position.x > 6.5, "{:?}", w.pose());
}

#[test]
fn stairs_are_climbed_up_and_down_at_eye_height() {
    let v = stairs();
    for run in [false, true] {
        let mut w = walker(&v, 2.0, 1.0, -90.0);
        let mut lowest_gain = f64::INFINITY;
        for _ in 0..900 {
            let before = w.pose().position.y;
            w.advance(Some(&v), &Intent { run, ..AHEAD }, 1.0 / 60.0);
            lowest_gain = lowest_gain.min(w.pose().position.y - before);
        }
        let top = w.pose().position;
        assert!(top.x > 14.0 && (top.y - 17.0 * 0.18 - 1.6).abs() < 0.06, "{top}");
        assert!(lowest_gain > -0.02, "the eye sank by {lowest_gain} on the way up");
        w.turn(180.0, 0.0);
        (0..900).for_each(|_| w.advance(Some(&v), &Intent { run, ..AHEAD }, 1.0 / 60.0));
        let bottom = w.pose().position;
        assert!(bottom.x < 1.0 && (bottom.y - 1.6).abs() < 0.06, "{bottom}");
    }
}

#[test]
fn the_head_turns_within_its_limit() {
    let v = rooms();
    let mut w = walker(&v, 1.0, 1.0, 170.0);
    w.turn(20.0, 500.0);
    assert_eq!((w.pose().yaw_deg, w.pose().pitch_deg), (-170.0, 60.0));
}

#[test]
fn after_a_stall_nobody_leaps() {
    let v = rooms();
    let mut w = walker(&v, 1.0, 1.0, -90.0);
    w.advance(Some(&v), &AHEAD, 60.0);
    assert!(w.pose().position.x < 1.0 + 1.4 * LONGEST_TIME_S);
}

#[test]
fn flyers_go_where_they_look_and_stay_in_the_box() {
    let v = WalkVolume::of_box(&Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 4.0, 10.0) }).unwrap();
    let mut w =
        Walker::new(Pose { position: DVec3::new(5.0, 1.0, 5.0), yaw_deg: 0.0, pitch_deg: 45.0 }, Some(&v), true, 60.0);
    (0..60).for_each(|_| w.advance(Some(&v), &AHEAD, 1.0 / 60.0));
    assert!(w.pose().position.y > 1.8, "{:?}", w.pose());
    (0..600).for_each(|_| w.advance(Some(&v), &Intent { up: 1.0, ..AHEAD }, 1.0 / 60.0));
    let p = w.pose().position;
    assert!(p.y > 3.99 && p.z < 0.01 && v.contains(p), "{p}");
}

#[test]
fn outsiders_are_brought_in() {
    let v = rooms();
    let w = walker(&v, 6.5, 1.0, 0.0);
    assert!(v.contains(w.pose().position));
    assert!((w.pose().position.x - 6.5).abs() < 0.51, "{:?}", w.pose());
    let begins = starts(&v);
    assert!(!begins.is_empty() && begins.iter().all(|b| v.contains(b.position)), "{begins:?}");
}

#[test]
fn a_visit_begins_where_the_view_is_open() {
    // A closet amid a hall.
    let v = volume([24, 24], |x, z| {
        let off = (x - 6.0f64).abs().max((z - 6.0f64).abs());
        (off < 0.75 || (2.0..6.0).contains(&off)).then_some(0.0)
    });
    let begin = starts(&v)[0];
    let ahead = ViewBasis::from_yaw_pitch(begin.yaw_deg, 0.0).forward;
    assert!(v.contains(begin.position + 4.0 * ahead), "{begin:?}");
    assert!((begin.position.x - 6.0).abs().max((begin.position.z - 6.0).abs()) > 1.9, "{begin:?}");
}

#[test]
fn a_visit_looks_away_from_the_walls_that_are_near() {
    let (v, collision) = furnished();
    // A metre before the diagonal wall, on its far side from the origin.
    let yaw_deg = outlook_deg(&v, &collision, DVec3::new(4.3, 1.6, 4.3));
    let ahead = ViewBasis::from_yaw_pitch(yaw_deg, 0.0).forward;
    assert!(ahead.x + ahead.z > 1.0, "{yaw_deg}");
}

/// A volume without walls around a room: floor, a diagonal wall from border to border, a pillar, a
/// step of 0.18 m.
fn furnished() -> (WalkVolume, CollisionGeometry) {
    let quads = [
        plate([0.0, 0.0], [12.0, 12.0], 0.0),
        wall([-0.5, 7.5], [7.5, -0.5], 0.0, 2.5),
        wall([2.0, 2.0], [2.4, 2.0], 0.0, 2.5),
        wall([2.4, 2.0], [2.4, 2.4], 0.0, 2.5),
        wall([2.4, 2.4], [2.0, 2.4], 0.0, 2.5),
        wall([2.0, 2.4], [2.0, 2.0], 0.0, 2.5),
    ];
    let v = volume([24, 24], |x, z| ((0.0..12.0).contains(&x) && (0.0..12.0).contains(&z)).then_some(0.0));
    (v, collision::of(&quads, DVec3::new(3.0, 1.6, 3.0)))
}

#[test]
fn walls_that_the_volume_does_not_know_are_slid_along_at_any_angle() {
    let (v, collision) = furnished();
    let ground = WalkSpace { volume: Some(&v), collision: Some(&collision), walls: true };
    // From the origin's side toward the wall, 20 degrees off its normal (yaw -135 looks along +x
    // +z).
    let mut w = walker(&v, 3.0, 3.0, -135.0 + 20.0);
    (0..120).for_each(|_| w.advance(ground, &AHEAD, 1.0 / 60.0));
    let p = w.pose().position;
    let from_wall = (7.0 - p.x - p.z) / 2.0f64.sqrt();
    assert!((BODY_M - 1e-6..BODY_M + 2e-3).contains(&from_wall), "{p}: {from_wall} m from the wall");
    // Along the wall with the sine of the angle.
    let along = (p.x - p.z) / 2.0f64.sqrt();
    let expected = 2.0 * WALK_M_PER_S * 20f64.to_radians().sin();
    assert!((along - expected).abs() < 0.1, "{along} m along the wall instead of {expected}");
    // Ghosts pass.
    let open = WalkSpace { walls: false, ..ground };
    (0..120).for_each(|_| w.advance(open, &AHEAD, 1.0 / 60.0));
    let p = w.pose().position;
    assert!(p.x + p.z > 7.5, "{p}");
}

#[test]
fn floors_are_followed_within_the_heights_of_the_volume() {
    let quads =
        [plate([0.0, 0.0], [4.0, 4.0], 0.0), plate([2.0, 0.0], [4.0, 4.0], 0.18), plate([3.0, 0.0], [4.0, 4.0], 0.62)];
    let v = volume([8, 8], |_, _| Some(0.0));
    let eye = DVec3::new(2.0, 1.6, 2.0);
    let on = |x: f64| {
        let collision = collision::of(&quads, eye);
        let mut w = walker(&v, x, 2.0, 0.0);
        let ground = WalkSpace { volume: Some(&v), collision: Some(&collision), walls: true };
        (0..240).for_each(|_| w.advance(ground, &Intent::default(), 1.0 / 60.0));
        w.pose().position.y
    };
    assert!((on(1.0) - 1.6).abs() < 1e-6 && (on(2.5) - 1.78).abs() < 1e-6);
    // What is higher than a knee is not stepped on.
    assert!((on(3.5) - 1.78).abs() < 1e-6, "{}", on(3.5));
}

proptest! {
    #[test]
    fn nobody_comes_nearer_to_a_wall_than_a_body(
        steps in prop::collection::vec((-180.0f64..180.0, -1.0f64..1.0, any::<bool>(), 0.0f64..0.2), 1..40),
    ) {
        let (v, collision) = furnished();
        let ground = WalkSpace { volume: Some(&v), collision: Some(&collision), walls: true };
        let mut w = walker(&v, 3.0, 3.0, 0.0);
        for (turn, right, run, dt) in steps {
            w.turn(turn, 0.0);
            w.advance(ground, &Intent { right, run, ..AHEAD }, dt);
            let p = w.pose().position;
            prop_assert!(v.contains(p) && p.x + p.z < 7.0, "{:?}", p);
            prop_assert!(collision.clearance(p.x, p.z).0 >= BODY_M - 1e-6, "{:?} {:?}", p, collision.clearance(p.x, p.z));
        }
    }

    #[test]
    fn nobody_leaves_the_volume(
        steps in prop::collection::vec((-180.0f64..180.0, -1.0f64..1.0, -1.0f64..1.0, any::<bool>(), 0.0f64..0.3), 1..60),
        which in 0..3,
    ) {
        let flying = which == 2;
        let v = match which {
            0 => rooms(),
            1 => stairs(),
            _ => WalkVolume::of_box(&Aabb { min: DVec3::ZERO, max: DVec3::new(9.0, 3.0, 7.0) }).unwrap(),
        };
        let mut w = Walker::new(Pose { position: DVec3::new(3.0, 1.6, 1.0), yaw_deg: 0.0, pitch_deg: 0.0 }, Some(&v), flying, 60.0);
        w.change_speed(8.0);
        for (turn, forward, right, run, dt) in steps {
            w.turn(turn, turn / 3.0);
            w.advance(Some(&v), &Intent { forward, right, up: right, turn: forward, tilt: right, run }, dt);
            prop_assert!(v.contains(w.pose().position), "{:?}", w.pose());
        }
    }
}

#[test]
fn a_raised_eye_keeps_its_height_and_stays_in_the_volume() {
    let v = stairs();
    for (raise_m, at_foot) in [(0.3, 1.9), (-0.4, 1.2), (9.0, 2.0)] {
        let mut w = walker(&v, 1.0, 1.0, -90.0);
        w.set_raise(raise_m);
        (0..120).for_each(|_| w.advance(Some(&v), &Intent::default(), 1.0 / 60.0));
        assert!((w.pose().position.y - at_foot).abs() < 0.01, "{raise_m}: {}", w.pose().position);
        assert!((w.nominal_eye().y + raise_m - w.pose().position.y).abs() < 1e-9);
        // Up the stairs, within the volume all the way.
        for _ in 0..600 {
            w.advance(Some(&v), &AHEAD, 1.0 / 60.0);
            assert!(v.contains(w.pose().position), "{raise_m}: {}", w.pose().position);
        }
        assert!(w.pose().position.x > 12.0, "{raise_m}: {}", w.pose().position);
    }
}
