//! Links to a view: `ldi://HOST/NAME#x,y,z,yaw,pitch`. `connect` opens what the window copies.

use glam::DVec3;
use ldi_protocol::Pose;
use std::{fmt, str::FromStr};

/// The scheme of links.
const SCHEME: &str = "ldi://";

/// A server, and a pose in its scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewLink {
    /// HOST, HOST:PORT or HOST/NAME.
    pub server: String,
    /// The pose; None in a link without one.
    pub pose: Option<Pose>,
}

impl fmt::Display for ViewLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SCHEME}{}", self.server)?;
        let Some(Pose { position: p, yaw_deg, pitch_deg }) = &self.pose else { return Ok(()) };
        write!(f, "#{:.3},{:.3},{:.3},{:.2},{:.2}", p.x, p.y, p.z, yaw_deg, pitch_deg)
    }
}

impl FromStr for ViewLink {
    type Err = String;

    /// Reads a link, or a server without the scheme.
    fn from_str(text: &str) -> Result<Self, String> {
        let Some(rest) = text.strip_prefix(SCHEME) else {
            return Ok(Self { server: text.to_owned(), pose: None });
        };
        let (server, place) = rest.split_once('#').map_or((rest, None), |(s, p)| (s, Some(p)));
        let server = server.trim_end_matches('/').to_owned();
        if server.is_empty() {
            return Err(format!("give a server, like {SCHEME}HOST/NAME#1.5,1.6,-2,90,0"));
        }
        Ok(Self { server, pose: place.map(parse_pose).transpose()? })
    }
}

/// Reads `X,Y,Z[,YAW[,PITCH]]`.
///
/// # Errors
/// If these are no three to five numbers.
pub fn parse_pose(text: &str) -> Result<Pose, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|n| n.trim().parse::<f64>().ok().filter(|n| n.is_finite()))
        .collect::<Option<_>>()
        .ok_or("give numbers with commas between them, like 1.5,1.6,-2,90")?;
    match numbers[..] {
        [x, y, z, ref angles @ ..] if angles.len() <= 2 => Ok(Pose {
            position: DVec3::new(x, y, z),
            yaw_deg: angles.first().copied().unwrap_or(0.0),
            pitch_deg: angles.get(1).copied().unwrap_or(0.0).clamp(-90.0, 90.0),
        }),
        _ => Err("give three to five numbers: X,Y,Z[,YAW[,PITCH]]".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_come_back() {
        let pose = Pose { position: DVec3::new(-4.33, 1.6, -7.7), yaw_deg: 26.0, pitch_deg: -12.5 };
        for server in ["museum.local", "museum.local:99/house", "[::1]:4433/a b"] {
            let link = ViewLink { server: server.into(), pose: Some(pose) };
            assert_eq!(link.to_string().parse(), Ok(link));
        }
        let link = ViewLink { server: "museum/house".into(), pose: Some(pose) };
        assert_eq!(link.to_string(), "ldi://museum/house#-4.330,1.600,-7.700,26.00,-12.50");
    }

    #[test]
    fn servers_alone_are_taken_as_they_are() {
        let server = |text: &str| text.parse::<ViewLink>().map(|l| (l.server, l.pose));
        for text in ["museum", "museum:4433", "museum/house#1"] {
            assert_eq!(server(text), Ok((text.into(), None)));
        }
        assert_eq!(server("ldi://museum/"), Ok(("museum".into(), None)));
        for wrong in ["ldi://", "ldi://#1,2,3", "ldi://museum#1,2", "ldi://museum#a,b,c"] {
            assert!(server(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn poses_are_read() {
        let pose = parse_pose("1,1.6,-2.5,90").unwrap();
        assert_eq!((pose.position, pose.yaw_deg, pose.pitch_deg), (DVec3::new(1.0, 1.6, -2.5), 90.0, 0.0));
        for wrong in ["", "1,2", "1,2,x", "1,2,3,4,5,6", "1,2,inf"] {
            assert!(parse_pose(wrong).is_err(), "{wrong}");
        }
    }
}
