//! A world of ten chunks whose views are stated by hand: at x metres the view needs chunk
//! floor(x), and chunk floor(x) + 1 sharpens.

use super::*;
use glam::DVec3;
use ldi_protocol::{
    Aabb, OutputCamera,
    index::{AngularRange, BuildSettings, CellEntry, ChunkEntry, ChunkHash, ChunkKind, GridPoint, SceneInfo},
    need::PREFETCH_SHARE,
    room_index::RoomIndex,
    rooms::{Cell, Portal, PortalKind, Rooms},
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
            max_deviation_px: 0.5,
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
                texel_density: vec![],
                levels: Vec::new(),
            })
            .collect(),
        materials: vec![],
        textures: vec![],
        pitch_bands_deg: vec![],
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
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

/// A walker on its way to larger x at 5 m/s, for half a second, ending at `x` at `ms`.
fn walks_to(p: &mut Planner, ms: u64, x: f64) {
    for i in (0..=30u64).rev() {
        let before = i * 500 / 30;
        p.pose(at((ms - before + 1) as u32, ms - before, x - before as f64 * 5e-3));
    }
}

/// A link so long that everything foreseen has to go at once.
const FAR: Capacity =
    Capacity { bytes_per_s: Some(1e6), round_trip: Duration::from_secs(9), decoded_per_s: None, waiting_bytes: 0 };

#[test]
fn the_view_comes_first_then_its_sharpness_then_what_comes_soon_and_no_earlier() {
    let mut p = planner(PlannerConfig::default());
    walks_to(&mut p, 1000, 4.9);
    // Chunk 6 sharpens from x = 5 on, chunk 7 from x = 6 on: in 20 and 220 ms.
    assert_eq!(drain(&mut p, ms(1000)), [(4, Urgency::Now), (5, Urgency::Fine), (6, Urgency::Predicted)]);
    let wake = p.wake_at().unwrap();
    assert!((ms(1005)..ms(1220)).contains(&wake), "{wake:?}");
    let sent: Vec<_> = (1001..1220).flat_map(|t| drain(&mut p, ms(t)).into_iter().map(move |s| (t, s))).collect();
    let Some(&(t, first)) = sent.first() else { panic!("chunk 7 goes before it is needed") };
    assert_eq!(first, (7, Urgency::Predicted));
    assert!((1010..1200).contains(&t), "not at once, and not too late: {sent:?}");
}

#[test]
fn a_longer_way_is_looked_farther_ahead() {
    let mut p = planner(PlannerConfig::default());
    walks_to(&mut p, 1000, 2.5);
    p.capacity(FAR);
    let ahead: Vec<u32> = drain(&mut p, ms(1000))[2..].iter().map(|s| s.0).collect();
    assert!(ahead.len() >= 4 && ahead.is_sorted() && ahead[0] == 4, "soonest first: {ahead:?}");
}

#[test]
fn nothing_goes_ahead_while_the_view_waits() {
    let mut p = planner(PlannerConfig::default());
    walks_to(&mut p, 1000, 4.9);
    let mut next = || p.next(ms(1000)).map(|o| o.chunk);
    assert_eq!([next(), next(), next()], [Some(4), Some(5), None]);
    p.sent(4);
    assert_eq!(p.next(ms(1000)), None);
    p.sent(5);
    assert_eq!(p.next(ms(1000)), Some(Order { chunk: 6, urgency: Urgency::Predicted }));
}

#[test]
fn what_the_client_evicted_goes_ahead_again_only_elsewhere() {
    let mut p = planner(PlannerConfig::default());
    walks_to(&mut p, 1000, 4.9);
    p.capacity(FAR);
    assert_eq!(drain(&mut p, ms(1000)).len(), 6, "all from 4 to 9");
    p.dropped(&[6, 8]);
    assert_eq!(drain(&mut p, ms(1100)), [], "they would be evicted again");
    p.pose(at(1200, 1200, 4.95));
    assert_eq!(drain(&mut p, ms(1200)), [], "hardly moved");
    p.pose(at(1300, 1300, 5.45));
    assert_eq!(drain(&mut p, ms(1300)), [(6, Urgency::Fine), (8, Urgency::Predicted)]);
}

/// Guesses against the motion worked out by hand.
#[test]
fn chunks_are_foreseen_when_the_walk_gets_to_them() {
    let mut forecast = Forecast { index: index(), views: Arc::new(ByX) };
    let mut motion = Motion::standing(at(1, 0, 2.5));
    assert!(
        forecast.expect(&motion, 4.0, 10.0, &|_| true).iter().all(|e| e.chunk == 2 || e.chunk == 3),
        "it stands and looks aside"
    );
    motion.velocity_m_s = DVec3::new(2.0, 0.0, 0.0);
    let found = forecast.expect(&motion, 2.0, 10.0, &|_| true);
    for chunk in 4..=6 {
        let e = found.iter().find(|e| e.chunk == chunk).unwrap();
        // Chunk n sharpens from x = n - 1 on; guesses lie up to 40% apart in time, 80 ms at least.
        let exact = (f64::from(chunk) - 3.5) / 2.0;
        assert!((exact * 0.75..=exact * 1.25 + 0.1).contains(&e.in_s), "{e:?} against {exact}");
        assert_eq!(e.urgency, Urgency::Predicted);
    }
    let chance = |chunk| found.iter().find(|e| e.chunk == chunk).unwrap().probability;
    assert!(chance(4) > chance(5) && chance(5) > chance(6));
    assert!(forecast.expect(&motion, 0.4, 10.0, &|_| true).iter().all(|e| e.chunk <= 4), "no farther than asked");
    assert!(forecast.expect(&motion, 2.0, 0.4, &|_| true).iter().all(|e| e.chunk <= 3), "within reach");
    // Looking along the way it would walk off that way.
    let mut looking = at(1, 0, 2.5);
    looking.pose.yaw_deg = -90.0;
    let found = forecast.expect(&Motion::standing(looking), 4.0, 10.0, &|_| true);
    assert!(found.iter().any(|e| e.chunk == 4 && e.urgency == Urgency::Around && e.probability < 0.6));
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
    let config = PlannerConfig { prefetch_m: 100.0, max_background: 2, max_flying: 3, ..Default::default() };
    let mut p = planner(config);
    walks_to(&mut p, 1000, 2.5);
    p.capacity(FAR);
    [2, 3].into_iter().for_each(|c| {
        p.next(ms(1000));
        p.sent(c);
    });
    let flying: Vec<Order> = std::iter::from_fn(|| p.next(ms(1000))).collect();
    assert!(flying.len() == 2 && flying.iter().all(|o| o.urgency == Urgency::Predicted), "{flying:?}");
    p.pose(at(2000, 2000, 7.5));
    let more: Vec<Order> = std::iter::from_fn(|| p.next(ms(2000))).collect();
    assert_eq!(more, [Order { chunk: 7, urgency: Urgency::Now }]);
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
    assert_eq!(p.next(ms(1000)), None);
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
    let mut p = planner(PlannerConfig { cache_bytes, ..Default::default() });
    walks_to(&mut p, 1000, 2.5);
    p.capacity(FAR);
    let sent = drain(&mut p, ms(1000));
    let share = (cache_bytes as f64 * PREFETCH_SHARE) as u64 / BYTES;
    assert_eq!(sent.len() as u64, share, "{sent:?}");
}

#[test]
fn asking_for_what_is_on_its_way_hurries_it_and_sends_nothing_twice() {
    let mut p = planner(PlannerConfig::default());
    walks_to(&mut p, 1000, 4.9);
    p.capacity(FAR);
    [4, 5].into_iter().for_each(|c| {
        p.next(ms(1000));
        p.sent(c);
    });
    let flying: Vec<Order> = std::iter::from_fn(|| p.next(ms(1000))).collect();
    let last = *flying.last().unwrap();
    assert_eq!(last.urgency, Urgency::Predicted);
    p.turns();
    assert!(p.want(&[last.chunk]).is_empty());
    p.check().unwrap();
    assert_eq!(p.turns(), [Turn::Reprioritize(Order { urgency: Urgency::Asked, ..last })]);
    p.sent(last.chunk);
    p.check().unwrap();
    assert!(drain(&mut p, ms(1000)).iter().all(|s| s.0 != last.chunk));
}

/// A room of 4 m by 10 m on either side of x = 4, with a door 6 m further along z than the walker
/// stands.
fn two_rooms() -> RoomIndex {
    let room = |name: &str, x: f64| {
        let (min, max) = (DVec3::new(x, 0.0, 0.0), DVec3::new(x + 4.0, 3.0, 10.0));
        Cell { name: name.into(), boxes: vec![Aabb { min, max }] }
    };
    let at = |y: f64, z: f64| DVec3::new(4.0, y, z);
    let corners = vec![at(0.0, 6.5), at(2.0, 6.5), at(2.0, 7.5), at(0.0, 7.5)];
    let door = Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners };
    let rooms = Rooms::new(0.1, vec![room("a", 0.0), room("b", 4.0)], vec![door]).unwrap();
    RoomIndex { rooms, cells_of: vec![vec![]; 3], placements: vec![[0..0, 0..0]], ..Default::default() }
}

/// At z metres the view needs chunk floor(z).
struct ByZ;
impl Views for ByZ {
    fn needed(&self, pose: &Pose) -> Needed {
        Needed { now: vec![(pose.position.z.max(0.0) as u32).min(CHUNKS - 1)], ..Default::default() }
    }
}

/// Somebody walks toward the wall: straight behind it lies the next room, which can be reached
/// through the door only.
#[test]
fn nobody_walks_through_walls() {
    let expected = |views: Arc<dyn Views>, rooms: Option<RoomIndex>, z: f64| {
        let index = Arc::new(Index { rooms, ..(*index()).clone() });
        let pose = |sequence, ms: u64, x: f64| {
            let position = DVec3::new(x, 1.6, z);
            PoseDatagram { sequence, sent_us: ms * 1000, pose: Pose { position, yaw_deg: -90.0, pitch_deg: 0.0 } }
        };
        let motion = (1..=30u32).fold(Motion::standing(pose(0, 0, 2.0)), |m, i| {
            m.then(pose(i, u64::from(i) * 20, 2.0 + 0.028 * f64::from(i)))
        });
        let found = Forecast { index, views }.expect(&motion, 10.0, 10.0, &|_| true);
        found.into_iter().map(|e| (e.chunk, e)).collect::<BTreeMap<u32, Expected>>()
    };
    let open = expected(Arc::new(ByX), None, 1.0);
    assert!(open[&7].urgency == Urgency::Predicted && open[&5].in_s < 2.0, "{open:?}");
    let walled = expected(Arc::new(ByX), Some(two_rooms()), 1.0);
    assert!(!walled.contains_key(&6) && !walled.contains_key(&7), "{walled:?}");
    // Before the door the way is free again.
    assert!(expected(Arc::new(ByX), Some(two_rooms()), 7.0)[&7].urgency == Urgency::Predicted);
    // Straight ahead nothing lies at the door's z, but the door does.
    assert!(!expected(Arc::new(ByZ), None, 1.0).contains_key(&7));
    let door = expected(Arc::new(ByZ), Some(two_rooms()), 1.0)[&7];
    let way_s = DVec3::new(1.16, 0.0, 6.0).length() / 1.4;
    assert!((door.in_s - way_s).abs() < 0.1 && door.urgency == Urgency::Around, "{door:?}");
}

/// Views backward need two chunks more.
struct Behind;
impl Views for Behind {
    fn needed(&self, pose: &Pose) -> Needed {
        let backward = pose.yaw_deg.to_radians().cos() < 0.0;
        Needed { base: vec![], now: if backward { vec![5, 6] } else { vec![0] }, fine: vec![] }
    }
}

#[test]
fn geometry_goes_at_once_whichever_way_the_walker_may_look() {
    let mut index = index();
    Arc::make_mut(&mut index).chunks[6].kind = ChunkKind::Ldi;
    let mut p = Planner::new(index, Arc::new(Behind), PlannerConfig::default());
    // A link over which an image would be there in time when the head has turned so far.
    p.capacity(Capacity { bytes_per_s: Some(1e9), ..Capacity::default() });
    p.pose(at(1, 0, 0.5));
    let sent = drain(&mut p, ms(0));
    assert_eq!(sent, [(0, Urgency::Now), (5, Urgency::Around)]);
}

/// Views between 100 and 104 degrees need two chunks more.
struct Slit;
impl Views for Slit {
    fn needed(&self, pose: &Pose) -> Needed {
        let through = (100.0..104.0).contains(&pose.yaw_deg.rem_euclid(360.0));
        Needed { base: vec![], now: if through { vec![5, 6] } else { vec![0] }, fine: vec![] }
    }
}

/// Where little is in view all of it is drawn, in directions too few for steps of a turn to meet:
/// 96 and 108 degrees are seen, and 100 to 104 are not.
#[test]
fn geometry_goes_at_once_that_few_directions_draw() {
    let mut index = index();
    let of = Arc::make_mut(&mut index);
    of.chunks[6].kind = ChunkKind::Ldi;
    of.settings.grid = ldi_protocol::index::CELLS.into();
    of.pitch_bands_deg = vec![-60.0, 60.0];
    let range = |yaw_start_deg, placement| AngularRange { yaw_start_deg, placement };
    let bands = vec![vec![range(100.0, None), range(104.0, Some(0))]];
    of.points = vec![GridPoint { position: DVec3::ZERO, level: 0, radius: 9.0, bands }];
    let mut p = Planner::new(index, Arc::new(Slit), PlannerConfig::default());
    p.capacity(Capacity { bytes_per_s: Some(1e9), ..Capacity::default() });
    p.pose(at(1, 0, 0.5));
    assert_eq!(drain(&mut p, ms(0)), [(0, Urgency::Now), (5, Urgency::Around)]);
}
