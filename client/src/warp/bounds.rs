//! Bounds of what a tile or a block of tiles draws, in its image.

/// What bounds something that is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    /// LDI pixels of the image: u from, v from, u to, v to.
    pub place: [f32; 4],
    /// Smallest and largest disparity, 1/m.
    pub disparity: [f32; 2],
}

impl Bounds {
    /// Of nothing.
    pub const NONE: Self = Self { place: [f32::MAX, f32::MAX, f32::MIN, f32::MIN], disparity: [f32::MAX, 0.0] };

    /// Extends them by a point.
    pub fn grow(&mut self, u: f32, v: f32, disparity: f32) {
        self.join(&Self { place: [u, v, u, v], disparity: [disparity, disparity] });
    }

    /// Extends them by others.
    pub fn join(&mut self, other: &Self) {
        let [u0, v0, u1, v1] = &mut self.place;
        let [from_u, from_v, to_u, to_v] = other.place;
        (*u0, *v0) = (u0.min(from_u), v0.min(from_v));
        (*u1, *v1) = (u1.max(to_u), v1.max(to_v));
        self.disparity = [self.disparity[0].min(other.disparity[0]), self.disparity[1].max(other.disparity[1])];
    }
}
