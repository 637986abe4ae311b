//! What a client's work costs, so that a build can suit its budget to it.
//!
//! A frame takes about `pixels * ns_per_pixel + triangles * ns_per_triangle + samples *
//! ns_per_sample`. Images pay where they take less time than the triangles that they stand for.

use serde::{Deserialize, Serialize};

/// Samples that a picture of images takes, per pixel: layers and borders come on top of one each.
const SAMPLES_PER_PIXEL: f64 = 1.2;
/// Bytes of a profile's file at most.
pub const MAX_FILE_BYTES: u64 = 1 << 16;
/// No smaller budget is chosen, whatever a profile says, triangles: scenes that exceed less are few.
pub const LEAST_BUDGET: u64 = 200_000;
/// No larger one, triangles: the client holds what it draws in memory.
const MOST_BUDGET: u64 = 20_000_000;
/// Characters of a name at most: it stands in reports and on terminals.
const MAX_NAME: usize = 64;

/// Costs of a client's work, nanoseconds each, above 0 and finite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClientProfile {
    /// Name, for reports.
    pub name: String,
    /// Of a triangle of near geometry, whatever it covers.
    pub ns_per_triangle: f64,
    /// Of a pixel: filling, shading, joining.
    pub ns_per_pixel: f64,
    /// Of a warped sample.
    pub ns_per_sample: f64,
}

impl ClientProfile {
    /// The two cores that the profiles were measured on.
    pub fn cpu() -> Self {
        Self { name: "cpu".into(), ns_per_triangle: 24.0, ns_per_pixel: 10.0, ns_per_sample: 55.0 }
    }

    /// The profiles that come with the program: `cpu` was measured, the others are estimates.
    pub fn named(name: &str) -> Option<Self> {
        let [ns_per_triangle, ns_per_pixel, ns_per_sample] = match name {
            "cpu" => return Some(Self::cpu()),
            "laptop" => [10.0, 4.0, 22.0],
            "workstation" => [0.6, 5.0, 3.0],
            _ => return None,
        };
        Some(Self { name: name.into(), ns_per_triangle, ns_per_pixel, ns_per_sample })
    }

    /// Reads a profile as `ldi-client calibrate` writes it.
    ///
    /// # Errors
    /// In words, if it is no such JSON, the name is too long or breaks its line, or a cost lies
    /// outside 1e-6 to 1e9 ns.
    pub fn from_json(text: &str) -> Result<Self, String> {
        let found: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        let costs = [found.ns_per_triangle, found.ns_per_pixel, found.ns_per_sample];
        if found.name.chars().count() > MAX_NAME || found.name.contains(char::is_control) {
            return Err(format!("the name must have at most {MAX_NAME} characters on one line"));
        }
        match costs.iter().all(|c| (1e-6..=1e9).contains(c)) {
            true => Ok(found),
            false => Err("costs must be numbers of nanoseconds above 0".into()),
        }
    }

    /// Triangles that take as long as images of a whole picture: with no more in view, images bring
    /// nothing. Two digits, for pictures of so many pixels.
    pub fn most_triangles(&self, pixels: f64) -> u64 {
        let most = SAMPLES_PER_PIXEL * pixels * self.ns_per_sample / self.ns_per_triangle;
        let most = most.clamp(LEAST_BUDGET as f64, MOST_BUDGET as f64);
        let unit = 10f64.powf(most.log10().floor() - 1.0);
        ((most / unit).floor() * unit) as u64
    }

    /// Milliseconds to expect of a frame that draws so many triangles, and images of the whole
    /// picture if it has any.
    pub fn frame_ms(&self, pixels: f64, triangles: u64, has_images: bool) -> f64 {
        let samples = if has_images { SAMPLES_PER_PIXEL * pixels } else { 0.0 };
        (pixels * self.ns_per_pixel + triangles as f64 * self.ns_per_triangle + samples * self.ns_per_sample) * 1e-6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_pay_beyond_what_they_take_themselves() {
        let profile = ClientProfile { name: "x".into(), ns_per_triangle: 20.0, ns_per_pixel: 5.0, ns_per_sample: 50.0 };
        let pixels = 1_000_000.0;
        assert_eq!(profile.most_triangles(pixels), 3_000_000);
        let (triangles, images) = (profile.frame_ms(pixels, 3_000_000, false), profile.frame_ms(pixels, 0, true));
        assert!((triangles - images).abs() < 1e-9 && (triangles - 65.0).abs() < 1e-9, "{triangles} {images}");
        let slow = ClientProfile { ns_per_triangle: 1e6, ..profile };
        assert_eq!(slow.most_triangles(pixels), 200_000);
    }

    #[test]
    fn profiles_come_back_and_nonsense_is_refused() {
        for name in ["cpu", "laptop", "workstation"] {
            let profile = ClientProfile::named(name).unwrap();
            assert_eq!(ClientProfile::from_json(&serde_json::to_string(&profile).unwrap()), Ok(profile));
        }
        assert_eq!(ClientProfile::named("abacus"), None);
        let with = |cost: &str| {
            ClientProfile::from_json(&format!(
                r#"{{"name": "x", "ns_per_triangle": {cost}, "ns_per_pixel": 1, "ns_per_sample": 1}}"#
            ))
        };
        assert!(with("3").is_ok());
        assert!(with("0").is_err() && with("-1").is_err() && with("1e300").is_err() && with("\"3\"").is_err());
        assert!(ClientProfile::from_json("[]").is_err());
        let named = |name: &str| {
            let profile = ClientProfile { name: name.into(), ..ClientProfile::cpu() };
            ClientProfile::from_json(&serde_json::to_string(&profile).unwrap())
        };
        assert!(named(&"x".repeat(64)).is_ok());
        assert!(named(&"x".repeat(65)).is_err() && named("x\u{1b}[2J").is_err() && named("x\ny").is_err());
    }
}
