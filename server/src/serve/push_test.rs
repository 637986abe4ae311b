//! The queue before the transport, and how much it hands over.

use super::*;
use ldi_protocol::wire::StreamKind;

fn send(number: u32, urgency: Urgency, bytes: usize) -> Task {
    let header = StreamHeader { kind: StreamKind::Chunk, urgency, number, bytes: bytes as u32 };
    Task::Send(header, Bytes::from(vec![0; bytes]))
}

fn order(queue: &Queue) -> Vec<(u32, Urgency)> {
    queue.pushes.values().map(|p| (p.header.number, p.header.urgency)).collect()
}

#[test]
fn the_most_urgent_goes_first_and_what_is_as_urgent_as_it_came() {
    let counters = Counters::default();
    let mut queue = Queue::default();
    for (number, urgency) in [(1, Urgency::Around), (2, Urgency::Fine), (3, Urgency::Now), (4, Urgency::Now)] {
        assert_eq!(queue.take(send(number, urgency, 10), &counters), None);
    }
    let now = |n| (n, Urgency::Now);
    assert_eq!(order(&queue), [now(3), now(4), (2, Urgency::Fine), (1, Urgency::Around)]);
    // What becomes urgent goes by when it came, and tells the client so.
    assert_eq!(queue.take(Task::Reprioritize(1, Urgency::Now), &counters), None);
    assert_eq!(order(&queue), [now(1), now(3), now(4), (2, Urgency::Fine)]);
    // What is out already is no longer ours.
    assert_eq!(queue.take(Task::Reprioritize(9, Urgency::Now), &counters), None);
    assert_eq!(queue.take(Task::Stop(9), &counters), None);
    assert_eq!(queue.take(Task::Stop(3), &counters), Some(3));
    assert_eq!(order(&queue), [now(1), now(4), (2, Urgency::Fine)]);
}

#[test]
fn a_window_is_the_congestion_windows_and_ten_milliseconds() {
    assert_eq!(send_window(500_000, None), 500_000 + MIN_UNSENT);
    assert_eq!(send_window(500_000, Some(1e6)), 500_000 + MIN_UNSENT, "10 ms are 10 kB");
    assert_eq!(send_window(500_000, Some(10e6)), 600_000);
}

#[test]
fn growth_ends_a_round_trip_after_the_window_stops_doubling() {
    let ms = Duration::from_millis;
    let mut growth = Growth::default();
    let mut at = |t: u64, window: u64| growth.goes_on(ms(t), ms(80), window);
    assert!(at(0, 14_720) && at(40, 14_720), "nothing is known yet");
    assert!(at(80, 29_440) && at(160, 58_880) && at(200, 58_880));
    assert!(!at(240, 60_000) && !at(300, 90_000), "looked at once per round trip");
    assert!(at(320, 120_000), "and it may grow again");
    assert!(!at(400, 120_000));
}
