//! Addresses that people type to reach this server.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// What clients connect to: the address itself, or those of this machine where it listens on all.
/// Which of them the network uses is asked of the system; no packet is sent.
pub(super) fn addresses_to_type(listening: SocketAddr) -> Vec<SocketAddr> {
    if !listening.ip().is_unspecified() {
        return vec![listening];
    }
    // Addresses for documentation (RFC 5737 and 3849): on no network, so by the usual way out.
    let ways: [(IpAddr, SocketAddr); 2] = [
        (Ipv4Addr::UNSPECIFIED.into(), (Ipv4Addr::new(192, 0, 2, 1), 9).into()),
        (Ipv6Addr::UNSPECIFIED.into(), (Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1), 9).into()),
    ];
    let own = ways.into_iter().filter(|(from, _)| listening.is_ipv6() || from.is_ipv4()).filter_map(|(from, to)| {
        let socket = std::net::UdpSocket::bind((from, 0)).ok()?;
        socket.connect(to).ok()?;
        socket.local_addr().ok()
    });
    let found: Vec<SocketAddr> = own.map(|own| (own.ip(), listening.port()).into()).collect();
    match found.is_empty() {
        true => vec![(Ipv4Addr::LOCALHOST, listening.port()).into()],
        false => found,
    }
}
