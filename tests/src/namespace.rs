//! A command behind a bad link: it runs in a network namespace whose only way out is a TUN device,
//! and a relay carries its packets.
//!
//! ```text
//!   this namespace                                     namespace of the command
//!   server ── TUN 10.77.0.1 ◀── Lane up ◀──┐  ┌── TUN 10.77.0.2 ── command
//!                           └──▶ Lane down ─┴──┘
//! ```
//!
//! In: a [`LinkSpec`] and a command. Out: how it ended, and what became of the packets. The link
//! is that of `--link`, but outside of the program that is tried: with the kernel's own sockets,
//! buffers and offloads, for any protocol over IPv4. Linux only, and only for whoever may make
//! namespaces and devices.

use anyhow::{Result, bail};
use ldi_client::stream::{LinkCounts, LinkSpec};
use std::process::{Command, ExitStatus};

/// What stands for this side's address in the arguments of a command.
pub const HOST: &str = "{host}";

/// How a command ended, and what became of its packets.
#[derive(Debug)]
pub struct Ended {
    /// Of the command.
    pub status: ExitStatus,
    /// Packets from the command, and to it.
    pub counts: [LinkCounts; 2],
}

/// Runs a command behind a link, to its end. [`HOST`] in its arguments becomes the address at
/// which it reaches this side.
///
/// # Errors
/// An empty command, one that cannot be started, or a system that gives no namespace or device.
pub fn run_behind(spec: LinkSpec, command: &[String]) -> Result<Ended> {
    let Some((program, arguments)) = command.split_first() else { bail!("there is no command to run") };
    platform::run(spec, |host| {
        let mut c = Command::new(program);
        c.args(arguments.iter().map(|a| a.replace(HOST, host)));
        c
    })
}

/// Whether this process may make namespaces and devices here.
///
/// # Errors
/// Why not.
pub fn available() -> Result<()> {
    platform::run(LinkSpec::default(), |_| Command::new("true")).map(|_| ())
}

#[cfg(target_os = "linux")]
mod platform {
    use super::{Command, Ended, LinkSpec, Result, bail};
    use anyhow::Context as _;
    use ldi_client::stream::{Direction, HEADER_BYTES, LinkCounts, PacketQueue};
    use nix::sched::{CloneFlags, unshare};
    use std::{
        io::{ErrorKind, Read as _, Write as _},
        net::{Ipv4Addr, UdpSocket},
        sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
        thread,
        time::Instant,
    };
    use tun::{Device, Reader, Writer};

    /// Bytes of a packet, at most; the kernel cuts what is larger.
    const MTU: u16 = 1500;
    /// Four addresses are enough for two.
    const NETMASK: Ipv4Addr = Ipv4Addr::new(255, 255, 255, 252);
    const MAY_NOT: &str = "only root may make network namespaces and TUN devices (CAP_SYS_ADMIN, CAP_NET_ADMIN)";

    pub fn run(spec: LinkSpec, command: impl FnOnce(&str) -> Command + Send) -> Result<Ended> {
        let [host, guest] = free_addresses()?;
        let near = device(host, guest)?;
        thread::scope(|scope| {
            // A namespace belongs to a thread, and to what it starts.
            let inside = scope.spawn(move || -> Result<Ended> {
                unshare(CloneFlags::CLONE_NEWNET).context(MAY_NOT)?;
                let far = device(guest, host)?;
                let ((from_near, to_near), (from_far, to_far)) = (near.split(), far.split());
                let ways = [
                    Way::open(spec, Direction::Up, from_far, to_near),
                    Way::open(spec, Direction::Down, from_near, to_far),
                ];
                let mut command = command(&host.to_string());
                let status =
                    command.status().with_context(|| format!("cannot run {}", command.get_program().display()))?;
                Ok(Ended { status, counts: ways.map(|w| w.counts()) })
            });
            inside.join().unwrap_or_else(|_| bail!("the thread of the namespace failed"))
        })
    }

    /// Addresses of both ends that no device here has yet.
    fn free_addresses() -> Result<[Ipv4Addr; 2]> {
        let is_free = |a: &Ipv4Addr| UdpSocket::bind((*a, 0)).is_err();
        let host = (0..=255).map(|k| Ipv4Addr::new(10, 77, k, 1)).find(is_free);
        let host = host.context("all of 10.77.0.0/16 is in use: wait until other links have ended")?;
        Ok([host, Ipv4Addr::from_bits(host.to_bits() + 1)])
    }

    /// A device in the calling thread's namespace. It is gone when it is closed.
    fn device(address: Ipv4Addr, peer: Ipv4Addr) -> Result<Device> {
        let mut config = tun::Configuration::default();
        config.address(address).netmask(NETMASK).destination(peer).mtu(MTU).up();
        tun::create(&config).map_err(|e| match std::fs::File::open("/dev/net/tun").map_err(|e| e.kind()) {
            Err(ErrorKind::NotFound) => {
                anyhow::anyhow!("/dev/net/tun is not there: `modprobe tun`, or give it to the container")
            }
            _ => anyhow::Error::new(e).context(MAY_NOT),
        })
    }

    /// One direction of the relay.
    struct Way {
        lane: Mutex<PacketQueue<Vec<u8>>>,
        /// A packet was put in.
        changed: Condvar,
        start: Instant,
    }

    impl Way {
        /// Relays until the process ends or a device is gone.
        fn open(spec: LinkSpec, direction: Direction, from: Reader, to: Writer) -> Arc<Self> {
            let lane = Mutex::new(PacketQueue::new(spec, direction));
            let way = Arc::new(Self { lane, changed: Condvar::new(), start: Instant::now() });
            let (taker, giver) = (way.clone(), way.clone());
            thread::spawn(move || taker.take_in(from));
            thread::spawn(move || giver.give_out(to));
            way
        }

        fn lane(&self) -> MutexGuard<'_, PacketQueue<Vec<u8>>> {
            self.lane.lock().unwrap_or_else(PoisonError::into_inner)
        }

        fn counts(&self) -> LinkCounts {
            self.lane().counts()
        }

        fn take_in(&self, mut from: Reader) {
            let mut buffer = [0; MTU as usize];
            while let Ok(n) = from.read(&mut buffer) {
                // What the kernel says of itself over IPv6 is no traffic of the command.
                if n == 0 || buffer[0] >> 4 != 4 {
                    continue;
                }
                let mut lane = self.lane();
                lane.send(self.start.elapsed(), n.saturating_sub(HEADER_BYTES), buffer[..n].to_vec());
                drop(lane);
                self.changed.notify_one();
            }
        }

        fn give_out(&self, mut to: Writer) {
            let mut lane = self.lane();
            loop {
                let now = self.start.elapsed();
                if let Some(packet) = lane.arrived(now) {
                    drop(lane);
                    // As any link, this one owes nobody a packet.
                    let _ = to.write_all(&packet);
                    lane = self.lane();
                    continue;
                }
                lane = match lane.next_at() {
                    Some(at) => self.changed.wait_timeout(lane, at - now).unwrap_or_else(PoisonError::into_inner).0,
                    None => self.changed.wait(lane).unwrap_or_else(PoisonError::into_inner),
                };
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod platform {
    use super::{Command, Ended, LinkSpec, Result, bail};

    pub fn run(_: LinkSpec, _: impl FnOnce(&str) -> Command + Send) -> Result<Ended> {
        bail!("network namespaces are Linux's; `--link` of ldi-client and ldi-load works everywhere")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_command_is_refused() {
        let e = run_behind(LinkSpec::default(), &[]).expect_err("nothing to run");
        assert!(e.to_string().contains("no command"), "{e}");
    }
}
