//! Directions, cut into pitch bands and yaw bins.
//!
//! The paper plans for yaw only. With free look, the directions are cut into bands of pitch;
//! everything a point promises for a band holds for each pitch in it. Certificates are kept per
//! unit: one pitch band times one yaw bin.

/// Widest pitch band, degrees. Narrower: tighter counts (a band of 10 degrees sees about a quarter
/// more solid angle than one direction), but longer planning. Wider than 15: counts grow fast.
const WIDEST_BAND_DEG: f64 = 10.0;
/// Yaw bins around the circle. More bins: smaller regions of users, so images may stand nearer,
/// but longer planning.
pub(super) const YAW_BINS: usize = 36;
/// Width of a yaw bin, degrees.
pub(super) const YAW_BIN_DEG: f64 = 360.0 / YAW_BINS as f64;

/// The cut of directions into bands and bins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Directions {
    /// Borders of the pitch bands, ascending, degrees.
    pub bands_deg: Vec<f64>,
}

impl Directions {
    /// Equal bands over -pitch to +pitch, none wider than [`WIDEST_BAND_DEG`]; a level gaze gets
    /// one band of one degree.
    pub fn new(pitch_deg: f64) -> Self {
        let pitch_deg = pitch_deg.max(0.5);
        let n = (2.0 * pitch_deg / WIDEST_BAND_DEG - 1e-9).ceil() as usize;
        Self { bands_deg: (0..=n).map(|i| -pitch_deg + 2.0 * pitch_deg * i as f64 / n as f64).collect() }
    }

    /// Number of bands.
    pub fn bands(&self) -> usize {
        self.bands_deg.len() - 1
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.bands() * YAW_BINS
    }

    /// Pitch from, to.
    pub fn band(&self, band: usize) -> [f64; 2] {
        [self.bands_deg[band], self.bands_deg[band + 1]]
    }

    /// Yaw from, to and pitch from, to of a unit.
    pub fn unit(&self, unit: usize) -> ([f64; 2], [f64; 2]) {
        let bin = (unit % YAW_BINS) as f64;
        ([bin * YAW_BIN_DEG, (bin + 1.0) * YAW_BIN_DEG], self.band(unit / YAW_BINS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_span_the_pitch_range() {
        let d = Directions::new(60.0);
        assert_eq!((d.bands(), d.bands_deg[0], d.bands_deg[12]), (12, -60.0, 60.0));
        assert_eq!(d.unit(d.units() - 1), ([350.0, 360.0], [50.0, 60.0]));
        assert_eq!(Directions::new(0.0).bands(), 1);
        assert_eq!(Directions::new(7.0).bands(), 2);
    }
}
