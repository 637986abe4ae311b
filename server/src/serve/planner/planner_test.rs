//! A world of ten chunks whose views are stated by hand: at x metres the view needs chunk floor(x), and chunk floor(x) + 1 sharpens.

use super::*;
use ldi_protocol::{
    Aabb, OutputCamera,
    index::{BuildSettings, CellEntry, ChunkEntry, ChunkHash, ChunkKind, SceneInfo},
    need::PREFETCH_SHARE,
};
use std::collections::BTreeSet;

const CHUNKS: u32 = 10;
const BYTES: u64 = 100;

struct ByX;
impl Views for ByX {
    fn needed(&self, pose: &Pose) -> Needed {
        let n = pose.position.x.floor() as u32;
        Needed { base: vec![], now: vec![n.min(CHUNKS - 1)], fine: vec![(n + 1).min(CHUNKS - 1)] }
    }
}

fn index() -> Arc<Index> {
    let bounds = Aabb { min: DVec3::ZERO, max: DVec3::ONE };
    Arc::new(Index {
        scene: SceneInfo { name: "line".into(), triangles: 1, unique_triangles: 1, instances: 1, bounds },
        settings: BuildSettings {
            budget: 1,
            optimize_budget: 1,
            camera: OutputCamera { width: 64, height: 48, fov_deg: 60.0 },
            max_footprint_px: 2.0,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "paper".into(),
            eye_height_m: None,
        },
        chunks: (0..CHUNKS)
            .map(|i| ChunkEntry {
                hash: ChunkHash([i as u8; 32]),
                stored_bytes: 10,
                decoded_bytes: BYTES as u32,
                kind: ChunkKind::Cell,
            })
            .collect(),
        cells: (0..CHUNKS)
            .map(|i| CellEntry {
                bounds: Aabb { min: DVec3::new(f64::from(i), 0.0, 0.0), max: DVec3::new(f64::from(i) + 0.9, 1.0, 1.0) },
                triangles: 1,
                chunk: i,
                bundles: vec![],
                materials: vec![],
            })
            .collect(),
        materials: vec![],
        textures: vec![],
        pitch_bands_deg: vec![],
        volume: None,
        tree: None,
        rooms: None,
        points: vec![],
        placements: vec![],
        images: vec![],
    })
}

fn planner(config: PlannerConfig) -> Planner {
    Planner::new(index(), Arc::new(ByX), config)
}

fn at(sequence: u32, ms: u64, x: f64) -> PoseDatagram {
    let pose = Pose { position: DVec3::new(x, 0.5, 0.5), yaw_deg: 0.0, pitch_deg: 0.0 };
    PoseDatagram { sequence, sent_us: ms * 1000, pose }
}

fn ms(n: u64) -> Duration {
    Duration::from_millis(n)
}

/// Sends one after another until nothing is left.
fn drain(p: &mut Planner, now: Duration) -> Vec<(u32, Urgency)> {
    let mut out = Vec::new();
    while let Some(o) = p.next(now) {
        p.check().unwrap();
        out.push((o.chunk, o.urgency));
        p.sent(o.chunk);
        p.check().unwrap();
    }
    out
}

#[test]
fn nothing_is_sent_before_the_first_pose() {
    assert_eq!(planner(PlannerConfig::default()).next(ms(0)), None);
}

#[test]
fn the_view_comes_first_then_its_sharpness_then_what_is_near() {
    let mut p = planner(PlannerConfig { prefetch_m: 3.0, ..Default::default() });
    p.pose(at(1, 0, 4.5));
    let sent = drain(&mut p, ms(0));
    assert_eq!(sent[0], (4, Urgency::Now));
    assert_eq!(sent[1], (5, Urgency::Fine));
    let around: Vec<u32> = sent[2..].iter().map(|s| s.0).collect();
    assert_eq!(around, [3, 6, 2, 7, 1], "near to far within 3 m of x = 4.5: {sent:?}");
    assert!(sent[2..].iter().all(|s| s.1 == Urgency::Around));
}

#[test]
fn a_walker_who_moves_gets_the_predicted_view_before_what_is_near() {
    let mut p = planner(PlannerConfig { prefetch_m: 3.0, ..Default::default() });
    p.pose(at(1, 0, 4.4));
    p.pose(at(2, 100, 4.9)); // 5 m/s: at 6.9 after 0.4 s, at 9.9 after 1 s
    let sent = drain(&mut p, ms(100));
    assert_eq!(
        sent[..5],
        [
            (4, Urgency::Now),
            (5, Urgency::Fine),
            (6, Urgency::Predicted),
            (9, Urgency::Predicted),
            (7, Urgency::Predicted)
        ]
    );
}

#[test]
fn a_jump_predicts_nothing() {
    let mut p = planner(PlannerConfig { prefetch_m: 0.5, ..Default::default() });
    p.pose(at(1, 0, 0.5));
    p.pose(at(2, 10, 7.5)); // 700 m/s
    assert!(drain(&mut p, ms(10)).iter().all(|s| s.1 != Urgency::Predicted));
}

#[test]
fn no_chunk_is_sent_twice_unless_it_was_dropped_or_asked_for() {
    let mut p = planner(PlannerConfig { prefetch_m: 0.0, ..Default::default() });
    let mut sent = Vec::new();
    for i in 0..90u32 {
        p.pose(at(i + 1, u64::from(i) * 100, f64::from(i) * 0.1));
        sent.extend(drain(&mut p, ms(u64::from(i) * 100)).into_iter().map(|s| s.0));
    }
    let unique: BTreeSet<u32> = sent.iter().copied().collect();
    assert_eq!(unique.len(), sent.len(), "{sent:?}");
    assert_eq!(unique.len(), CHUNKS as usize);

    p.dropped(&[8, 3, 77]);
    assert_eq!(drain(&mut p, ms(20_000)), [(8, Urgency::Now)], "3 is not in view");
    assert_eq!(p.want(&[3, 3, 77, 5]), [77]);
    assert_eq!(drain(&mut p, ms(20_000)), [(3, Urgency::Asked), (5, Urgency::Asked)]);
}

#[test]
fn what_the_client_has_from_before_is_not_sent() {
    let mut p = planner(PlannerConfig { prefetch_m: 0.0, ..Default::default() });
    p.have(&[4, 99]);
    p.pose(at(1, 0, 4.5));
    assert_eq!(drain(&mut p, ms(0)), [(5, Urgency::Fine)]);
}

#[test]
fn an_old_pose_changes_nothing() {
    let mut p = planner(PlannerConfig::default());
    assert!(p.pose(at(5, 0, 4.5)));
    assert!(!p.pose(at(4, 0, 7.5)));
    assert_eq!(p.next(ms(0)).unwrap().chunk, 4);
}

#[test]
fn the_background_leaves_room_for_what_the_view_needs() {
    let config = PlannerConfig { prefetch_m: 100.0, max_background: 2, max_flying: 5, ..Default::default() };
    let mut p = planner(config);
    p.pose(at(1, 0, 0.5));
    let flying: Vec<Order> = std::iter::from_fn(|| p.next(ms(0))).collect();
    assert_eq!(flying.len(), 4, "two for the view, two behind it: {flying:?}");
    p.pose(at(2, 1000, 6.5));
    let more: Vec<Order> = std::iter::from_fn(|| p.next(ms(1000))).collect();
    assert_eq!(more, [Order { chunk: 6, urgency: Urgency::Now }]);
    p.check().unwrap();
}

#[test]
fn chunks_on_their_way_follow_the_walker() {
    let mut p = planner(PlannerConfig { prefetch_m: 0.0, max_flying: 2, ..Default::default() });
    p.pose(at(1, 0, 2.5));
    let flying: Vec<u32> = std::iter::from_fn(|| p.next(ms(0))).map(|o| o.chunk).collect();
    assert_eq!(flying, [2, 3]);
    assert!(p.turns().is_empty());
    // One step on: 3 is needed now, 2 no more. Nothing is planned while all slots are taken.
    p.pose(at(2, 1000, 3.5));
    p.replan(ms(1000));
    assert_eq!(p.turns(), [Turn::Stale(2), Turn::Reprioritize(Order { chunk: 3, urgency: Urgency::Now })]);
    assert!(p.turns().is_empty(), "a change is told once");
    p.aborted(2);
    p.check().unwrap();
    assert_eq!(p.next(ms(1000)), Some(Order { chunk: 4, urgency: Urgency::Fine }));
    // Back again: what was stopped is sent again.
    p.sent(3);
    p.sent(4);
    p.pose(at(3, 2000, 2.5));
    assert_eq!(drain(&mut p, ms(2000)), [(2, Urgency::Now)]);
}

#[test]
fn plans_keep_their_distance_in_time() {
    let mut p = planner(PlannerConfig { prefetch_m: 0.0, replan_interval: ms(25), ..Default::default() });
    p.pose(at(1, 0, 2.5));
    drain(&mut p, ms(0));
    p.pose(at(2, 10, 6.5));
    assert_eq!(p.next(ms(10)), None);
    assert_eq!(p.wake_at(), Some(ms(25)));
    assert_eq!(p.next(ms(25)).unwrap().chunk, 6);
    assert_eq!(p.wake_at(), None);
}

#[test]
fn prefetch_stays_within_its_share_of_the_cache() {
    let cache_bytes = 6 * BYTES;
    let mut p = planner(PlannerConfig { prefetch_m: 1e6, cache_bytes, ..Default::default() });
    p.pose(at(1, 0, 4.5));
    let sent = drain(&mut p, ms(0));
    let share = (cache_bytes as f64 * PREFETCH_SHARE) as u64 / BYTES;
    assert_eq!(sent.len() as u64, share, "{sent:?}");
}

#[test]
fn asking_for_what_is_on_its_way_hurries_it_and_sends_nothing_twice() {
    let mut p = planner(PlannerConfig { prefetch_m: 3.0, ..Default::default() });
    p.pose(at(1, 0, 4.5));
    let flying: Vec<Order> = std::iter::from_fn(|| p.next(ms(0))).collect();
    let last = *flying.last().unwrap();
    assert_eq!(last.urgency, Urgency::Around);
    p.turns();
    assert!(p.want(&[last.chunk]).is_empty());
    p.check().unwrap();
    assert_eq!(p.turns(), [Turn::Reprioritize(Order { urgency: Urgency::Asked, ..last })]);
    p.sent(last.chunk);
    p.check().unwrap();
    assert!(drain(&mut p, ms(0)).iter().all(|s| s.0 != last.chunk));
}
