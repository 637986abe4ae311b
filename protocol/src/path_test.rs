//! Walks computed by hand, and every way in which a file can be wrong.

use super::*;

fn walk_of(json: &str) -> Walk {
    parse(json).expect("a valid path")
}

/// Message of a path that must be refused.
fn refusal(json: &str) -> String {
    parse(json).expect_err("an invalid path").to_string()
}

#[test]
fn a_right_angle_by_hand() {
    // 1 m per frame; 60 degrees per frame of turning. Ahead 2.5 m (-Z), then 1 m to the left (-X).
    let w = walk_of(r#"{"fps": 2, "speed": 2, "waypoints": [[0,1,0],[0,1,-2.5],[-1,1,-2.5]]}"#);
    let got: Vec<_> = w.poses.iter().map(|p| (p.t_s, p.pose.position.to_array(), p.pose.yaw_deg)).collect();
    let want = vec![
        (0.0, [0.0, 1.0, 0.0], 0.0),
        (0.5, [0.0, 1.0, -1.0], 0.0),
        (1.0, [0.0, 1.0, -2.0], 0.0),
        (1.5, [0.0, 1.0, -2.5], 0.0),
        (2.0, [0.0, 1.0, -2.5], 60.0),
        (2.5, [0.0, 1.0, -2.5], 90.0),
        (3.0, [-1.0, 1.0, -2.5], 90.0),
    ];
    assert_eq!(got, want);
}

#[test]
fn headings_follow_the_convention() {
    for (to, yaw) in
        [([0, 0, -1], 0.0), ([-1, 0, 0], 90.0), ([0, 0, 1], 180.0), ([1, 0, 0], -90.0), ([-1, 5, -1], 45.0)]
    {
        let w = walk_of(&format!(r#"{{"waypoints": [[0,0,0], {to:?}]}}"#));
        assert_eq!(w.poses[0].pose.yaw_deg, yaw, "{to:?}");
        let forward = w.poses[0].pose.basis().forward;
        let d = DVec3::new(f64::from(to[0]), 0.0, f64::from(to[2])).normalize();
        assert!(forward.distance(d) < 1e-9);
    }
}

#[test]
fn a_closed_path_returns_and_an_open_one_stops() {
    let corners = "[[0,0,0],[4,0,0],[4,0,3]]";
    let open = walk_of(&format!(r#"{{"waypoints": {corners}}}"#));
    let closed = walk_of(&format!(r#"{{"waypoints": {corners}, "closed": true}}"#));
    assert_eq!(open.poses.last().expect("poses").pose.position, DVec3::new(4.0, 0.0, 3.0));
    assert_eq!(closed.poses.last().expect("poses").pose.position, DVec3::ZERO);
    assert_eq!(closed.poses[..open.poses.len() - 1], open.poses[..open.poses.len() - 1]);
}

#[test]
fn neither_steps_nor_turns_exceed_the_walkers_speed() {
    let w = walk_of(
        r#"{"waypoints": [[0,0,0],[0.3,0,0.01],[0.3,0,0.01],[0.6,0,0.02],[0.6,2,0.02],[0,0,0],[5,0,1]], "closed": true}"#,
    );
    for pair in w.poses.windows(2) {
        let (a, b) = (pair[0].pose, pair[1].pose);
        assert!(a.position.distance(b.position) <= 1.4 / 60.0 + 1e-12);
        let turned = turn(a.yaw_deg, b.yaw_deg).abs();
        assert!(turned <= 120.0 / 60.0 + 1e-12, "{turned}");
        assert!(turned <= ALIGNED_DEG || a.position == b.position, "turns only while standing");
        assert!(pair[1].t_s > pair[0].t_s);
    }
}

#[test]
fn a_bend_within_a_degree_is_walked_through() {
    // tan(0.5 degrees) * 10 = 0.0873
    let w = walk_of(r#"{"fps": 10, "speed": 3, "waypoints": [[0,0,0],[0,0,-10],[0.0873,0,-20]]}"#);
    let steps: Vec<f64> = w.poses.windows(2).map(|p| p[0].pose.position.distance(p[1].pose.position)).collect();
    assert!(steps[..steps.len() - 1].iter().all(|s| (s - 0.3).abs() < 1e-4), "{steps:?}");
}

#[test]
fn degenerate_paths_stand_still() {
    assert_eq!(walk_of(r#"{"waypoints": [[1,2,3]]}"#).poses.len(), 1);
    assert_eq!(walk_of(r#"{"waypoints": [[1,2,3],[1,2,3]], "closed": true}"#).poses.len(), 1);
    let up = walk_of(r#"{"waypoints": [[0,0,0],[0,1,0],[1,1,0]]}"#);
    assert!(up.poses.iter().all(|p| p.pose.yaw_deg == -90.0), "a climb looks where the walk goes on");
}

#[test]
fn explicit_poses_are_taken_as_they_are() {
    let w = walk_of(
        r#"{"eye_height": 1.7, "poses": [{"position": [1,2,3], "yaw": 370, "pitch": -30}, {"t": 5, "position": [1,2,4], "yaw": 0}]}"#,
    );
    assert_eq!(w.eye_height, Some(1.7));
    assert_eq!(w.poses[0].pose, Pose { position: DVec3::new(1.0, 2.0, 3.0), yaw_deg: 370.0, pitch_deg: -30.0 });
    assert_eq!((w.poses[1].t_s, w.poses[1].pose.pitch_deg), (5.0, 0.0));
}

#[test]
fn a_walk_survives_its_own_text() {
    let w = walk_of(r#"{"waypoints": [[0.1,0.2,0.3],[1.7,0.2,-3.3],[2,1,2]], "closed": true, "eye_height": 1.6}"#);
    assert!(walk_of(&w.to_json()) == w);
}

#[test]
fn evenly_spaced_numbers() {
    let mut w = walk_of(r#"{"waypoints": [[0,0,0],[1,0,0]]}"#);
    w.poses.truncate(10);
    assert_eq!(w.evenly_spaced(5), vec![0, 2, 4, 6, 8]);
    assert_eq!(w.evenly_spaced(99).len(), 10);
}

#[test]
fn fields_that_mean_nothing_are_told() {
    let told = |json: &str| unknown_fields(json);
    assert_eq!(told(r#"{"waypoints": [[0,0,0]], "fps": 30, "speed": 1, "eye_height": 1, "closed": true}"#), None);
    assert_eq!(told(r#"{"poses": [{"position": [0,0,0], "yaw": 0, "mine": 1}]}"#), None);
    let slip = told(r#"{"waypoints": [[0,0,0]], "speeed": 2, "by": {"x": 1}}"#).expect("a slip");
    assert!(slip.starts_with("`by`, `speeed` ignored: a path file has `fps`, `speed`"), "{slip}");
    // What is no path file at all is told by `parse`.
    assert_eq!(told("[1,2"), None);
    let mut heard = String::new();
    let slip = r#"{"waypoints": [[0,0,0],[1,0,0]], "by": 1}"#;
    assert!(read(slip.as_bytes(), |told| heard = told.to_owned()).is_ok() && heard.starts_with("`by` ignored"));
    assert!(matches!(read(&[0xff, 0xfe][..], |_| ()), Err(PathError::Read(_))));
    // The list is that of the file's fields.
    let whole = PathFile {
        fps: Some(60.0),
        speed: Some(1.0),
        eye_height: Some(1.6),
        closed: false,
        waypoints: Some(vec![]),
        poses: Some(vec![]),
    };
    let written = serde_json::to_value(&whole).unwrap();
    let mut fields: Vec<_> = written.as_object().unwrap().keys().map(|k| &**k).collect();
    let mut known = FIELDS.to_vec();
    fields.sort_unstable();
    known.sort_unstable();
    assert_eq!(fields, known);
}

#[test]
fn errors_name_the_field() {
    for (json, names) in [
        (r#"{}"#, "none of"),
        (r#"{"waypoints": []}"#, "none of"),
        (r#"{"waypoints": [[0,0,0]], "poses": [{"position": [0,0,0], "yaw": 0}]}"#, "both"),
        (r#"{"waypoints": [[0,0,0],[1,2e7,0]]}"#, "waypoints[1].y"),
        (r#"{"waypoints": [[0,0]]}"#, "line 1"),
        (r#"{"waypoints": [[0,0,0]], "fps": 0}"#, "fps"),
        (r#"{"waypoints": [[0,0,0]], "speed": -1}"#, "speed"),
        (r#"{"waypoints": [[0,0,0]], "eye_height": -1}"#, "eye_height"),
        (r#"{"poses": [{"position": [0,0,0], "yaw": 0, "pitch": 91}]}"#, "poses[0].pitch"),
        (r#"{"poses": [{"position": [0,0,0]}]}"#, "yaw"),
        (
            r#"{"poses": [{"t": 2, "position": [0,0,0], "yaw": 0}, {"t": 1, "position": [0,0,0], "yaw": 0}]}"#,
            "poses[1].t",
        ),
        (r#"{"waypoints": [[0,0,0],[1e6,0,0]], "speed": 0.01}"#, "multiply them by 0.001"),
        (r#"{"waypoints": [[0,0,1e999]]}"#, "out of range"),
        ("[1,2", "EOF"),
    ] {
        assert!(refusal(json).contains(names), "{json}: {}", refusal(json));
    }
}
