use super::*;
use proptest::prelude::*;

fn spec(text: &str) -> LinkSpec {
    text.parse().expect("a link")
}

const MS: Duration = Duration::from_millis(1);

/// One packet of 1,222 bytes (10,000 bits with headers) every `every`, `n` of them.
fn steady(link: &mut SimulatedLink, every: Duration, n: u32) -> Vec<Fate> {
    (0..n).map(|i| link.send(every * i, 1222)).collect()
}

#[test]
fn every_key_is_read_and_every_key_is_optional() {
    let all = spec("rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=1.5s:200ms,queue=100ms,seed=7");
    let ms = |n| Duration::from_millis(n);
    assert_eq!(
        all,
        LinkSpec {
            rate_bit_s: Some(20e6),
            delay: ms(20),
            jitter: ms(5),
            loss: 0.02,
            duplicates: 0.01,
            blackout: Some((ms(1500), ms(200))),
            queue: ms(100),
            seed: 7
        }
    );
    assert_eq!(spec(&all.to_string()), all, "what is shown can be read");
    assert_eq!(spec("delay=1.5ms"), LinkSpec { delay: Duration::from_micros(1500), ..LinkSpec::default() });
    assert_eq!(spec(" rate=1Gbit , loss=0% ").rate_bit_s, Some(1e9));
    assert_eq!(spec("rate=640kbit").rate_bit_s, Some(640e3));
    assert_eq!(spec("delay=250us,queue=2s").queue, Duration::from_secs(2));
}

#[test]
fn what_is_wrong_is_named_with_an_example() {
    for (text, named) in [
        ("", "\"\" is not KEY=VALUE"),
        ("fast", "\"fast\" is not"),
        ("speed=3mbit", "\"speed\" is none of rate, delay"),
        ("rate=20", "rate=20: a rate"),
        ("rate=20mb", "bit, kbit, mbit or gbit"),
        ("rate=0mbit", "8kbit"),
        ("rate=-1mbit", "rate=-1mbit"),
        ("rate=infmbit", "rate=inf"),
        ("delay=20", "us, ms or s"),
        ("delay=61s", "0 to 60 s"),
        ("loss=2", "with the sign"),
        ("loss=101%", "0% to 100%"),
        ("loss=NaN%", "loss=NaN%"),
        ("dup=2", "with the sign"),
        ("blackout=2s", "START:LENGTH"),
        ("blackout=2s:1d", "START:LENGTH"),
        ("seed=-1", "whole number"),
        ("delay=1ms,delay=2ms", "twice"),
        ("delay=1ms,", "is not KEY=VALUE"),
    ] {
        let e = text.parse::<LinkSpec>().expect_err(text).to_string();
        assert!(e.contains(named) && e.contains("for example rate=20mbit,"), "{text}: {e}");
    }
}

#[test]
fn times_of_arrival_are_exact() {
    // 10 Mbit/s: a packet of 10,000 bits takes 1 ms.
    let mut link = SimulatedLink::new(spec("rate=10mbit,delay=20ms,queue=2ms"), Direction::Down);
    let mut at = |ms: u32, bytes| link.send(MS * ms, bytes);
    assert_eq!(at(0, 1222), Fate::Arrives(MS * 21));
    assert_eq!(at(0, 1222), Fate::Arrives(MS * 22));
    assert_eq!(at(0, 597), Fate::Arrives(MS * 22 + MS / 2), "half as long");
    assert_eq!(at(0, 1222), Fate::Dropped, "2.5 ms wait already");
    assert_eq!(at(1, 1222), Fate::Arrives(MS * 23 + MS / 2), "one has left");
    assert_eq!(at(9, 1222), Fate::Arrives(MS * 30), "an idle link saves nothing up");
    assert_eq!(
        link.counts(),
        LinkCounts { sent: 6, delivered: 5, doubled: 0, lost: 0, dropped: 1, bytes: 4 * 1222 + 597 }
    );
}

#[test]
fn without_keys_nothing_happens_to_a_packet() {
    let mut link = SimulatedLink::new(LinkSpec::default(), Direction::Up);
    assert!(steady(&mut link, MS, 50).iter().zip(0..).all(|(f, i)| *f == Fate::Arrives(MS * i)));
}

#[test]
fn a_steady_excess_gets_the_rate_and_waits_as_long_as_the_queue() {
    // Twice what fits, for 10 s.
    let mut link = SimulatedLink::new(spec("rate=10mbit,queue=50ms"), Direction::Down);
    let fates = steady(&mut link, MS / 2, 20_000);
    let c = link.counts();
    assert!((10_000..=10_060).contains(&c.delivered), "{c:?}");
    let waits = fates.iter().zip(0u32..).filter_map(|(f, i)| match f {
        Fate::Arrives(at) => Some(*at - MS / 2 * i),
        _ => None,
    });
    let longest = waits.max().expect("some");
    assert!(longest > MS * 50 && longest <= MS * 51, "{longest:?}");
}

#[test]
fn loss_is_the_share_that_was_asked_for_and_independent_of_time() {
    let lost = |every: Duration, seed: u64, direction| {
        let mut link = SimulatedLink::new(LinkSpec { seed, ..spec("loss=2%,jitter=3ms") }, direction);
        let fates = steady(&mut link, every, 100_000);
        (0..).zip(fates).filter(|(_, f)| *f == Fate::Lost).map(|(i, _)| i).collect::<Vec<u32>>()
    };
    let first = lost(MS, 1, Direction::Down);
    // 2,000 expected, standard deviation 44.
    assert!((1_800..2_200).contains(&first.len()), "{}", first.len());
    assert_eq!(first, lost(MS * 7, 1, Direction::Down), "the n-th packet's luck is its own");
    for other in [lost(MS, 2, Direction::Down), lost(MS, 1, Direction::Up)] {
        let both = other.iter().filter(|i| first.binary_search(i).is_ok()).count();
        // 40 expected of independent draws.
        assert!(both < 100, "{both}");
    }
    assert_eq!(SimulatedLink::new(spec("loss=100%"), Direction::Up).send(MS, 1), Fate::Lost);
}

#[test]
fn packets_overtake_each_other_only_by_jitter() {
    let arrivals = |text: &str| {
        let fates = steady(&mut SimulatedLink::new(spec(text), Direction::Down), MS, 2_000);
        let at = fates.into_iter().filter_map(|f| if let Fate::Arrives(t) = f { Some(t) } else { None });
        at.collect::<Vec<_>>()
    };
    let overtaken = |a: &[Duration]| a.windows(2).filter(|w| w[1] < w[0]).count();
    assert_eq!(overtaken(&arrivals("rate=20mbit,delay=20ms,loss=2%")), 0);
    assert_eq!(overtaken(&arrivals("rate=20mbit,delay=20ms,jitter=900us")), 0, "less than the time between two");
    // Two even draws from 5 ms, 1 ms apart: the later arrives first with probability (4/5)^2 / 2.
    let share = overtaken(&arrivals("delay=20ms,jitter=5ms")) as f64 / 1_999.0;
    assert!((share - 0.32).abs() < 0.05, "{share}");
}

#[test]
fn in_a_black_out_everything_is_lost_and_nothing_else() {
    let mut link = SimulatedLink::new(spec("blackout=100ms:50ms"), Direction::Up);
    let fates = steady(&mut link, MS, 300);
    assert!((0..).zip(&fates).all(|(i, f)| (*f == Fate::Lost) == (100..150).contains(&i)), "{fates:?}");
    assert_eq!(link.counts().lost, 50);
}

#[test]
fn some_packets_arrive_twice_and_count_once() {
    let mut link = SimulatedLink::new(spec("dup=10%,delay=20ms,jitter=5ms"), Direction::Down);
    let fates = steady(&mut link, MS, 10_000);
    let twice: Vec<_> = (0u32..).zip(&fates).filter(|(_, f)| matches!(f, Fate::ArrivesTwice(..))).collect();
    // 1,000 expected, standard deviation 30.
    assert!((850..1_150).contains(&twice.len()), "{}", twice.len());
    let c = link.counts();
    assert_eq!((c.delivered, c.doubled as usize, c.bytes), (10_000, twice.len(), 10_000 * 1222));
    let late = |i: u32, at: Duration| at - MS * i;
    let mut apart = 0;
    for (i, fate) in twice {
        let Fate::ArrivesTwice(a, b) = *fate else { unreachable!() };
        assert!([a, b].iter().all(|t| (MS * 20..=MS * 25).contains(&late(i, *t))));
        apart += usize::from(a != b);
    }
    assert!(apart > 800, "each has a lateness of its own");
}

proptest! {
    #[test]
    fn packets_are_conserved_the_rate_is_kept_and_delays_are_bounded(
        seed: u64,
        rate_kbit in 100u32..200_000,
        delay_ms in 0u32..200,
        jitter_ms in 0u32..50,
        queue_ms in 0u32..200,
        loss in 0.0f64..0.5,
        packets in prop::collection::vec((0u64..2_000_000, 1usize..1500), 1..300),
    ) {
        let spec = LinkSpec {
            rate_bit_s: Some(f64::from(rate_kbit) * 1e3),
            delay: MS * delay_ms,
            jitter: MS * jitter_ms,
            loss,
            queue: MS * queue_ms,
            seed,
            ..LinkSpec::default()
        };
        let run = |spec| {
            let mut link = SimulatedLink::new(spec, Direction::Down);
            let mut now = Duration::ZERO;
            let fates: Vec<(Duration, usize, Fate)> = packets.iter().map(|(gap_ns, bytes)| {
                now += Duration::from_nanos(*gap_ns);
                (now, *bytes, link.send(now, *bytes))
            }).collect();
            (fates, link.counts())
        };
        let (fates, c) = run(spec);
        prop_assert_eq!(&run(spec).0, &fates, "the same seed, the same outcome");
        prop_assert_eq!(c.sent as usize, packets.len());
        prop_assert_eq!(c.sent, c.delivered + c.lost + c.dropped);
        // Without jitter and delay a packet arrives when its last bit has passed; loss takes its
        // share too, so it is left out here.
        let (bare, _) = run(LinkSpec { delay: Duration::ZERO, jitter: Duration::ZERO, loss: 0.0, ..spec });
        let passed: Vec<(Duration, usize)> = bare.iter()
            .filter_map(|(_, bytes, fate)| if let Fate::Arrives(t) = fate { Some((*t, *bytes + HEADER_BYTES)) } else { None })
            .collect();
        for i in 0..passed.len() {
            let mut bits = 0.0;
            for j in i + 1..passed.len() {
                bits += passed[j].1 as f64 * 8.0;
                let window = (passed[j].0 - passed[i].0).as_secs_f64();
                prop_assert!(bits <= window * f64::from(rate_kbit) * 1e3 + 1e-3, "{bits} bits in {window} s");
            }
        }
        for (sent, bytes, fate) in fates {
            if let Fate::Arrives(t) = fate {
                let pass = Duration::from_secs_f64((bytes + HEADER_BYTES) as f64 * 8.0 / (f64::from(rate_kbit) * 1e3));
                let least = sent + pass + spec.delay;
                prop_assert!(t >= least && t <= least + spec.queue + spec.jitter + Duration::from_nanos(2));
            }
        }
    }
}
