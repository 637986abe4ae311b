//! The merge rules of portal images (Rafferty, Aliaga, Popescu and Lastra 1998, section 4.1):
//! which samples a place of the layered image keeps.
//!
//! In: the samples that warp to one place, image by image. Out: those that stay, nearest first.
//! The rules, one by one:
//!
//! 1. Samples of the central image are in the first layer and can be neither pushed back nor
//!    eliminated.
//! 2. A sample of a later image at no similar depth is new: it is kept, in a layer of its own.
//! 3. At a similar depth there is a conflict, and the sample that shows the smaller piece of
//!    surface in its own image stays.
//! 4. Two samples of one image are both kept, however near: surfaces along the lines of sight need
//!    them.
//!
//! The paper establishes "similar" by trial, once per model, and does not say in which measure;
//! here it is a share of the depth. Where rule 1 meets a sample before the central one (its pixel
//! is on a silhouette, and the layers are sorted), the sample is left out.

use serde::{Deserialize, Serialize};

/// Two samples are at a similar depth if their depths differ by at most this share, unless told
/// otherwise. Smaller: surfaces are held several times, as each image samples them at other
/// places; larger: what stands before a wall is taken for the wall. By trial on the house.
pub const SAME_DEPTH: f64 = 0.02;

/// What the rules look at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offer {
    /// Rank of its image: 0 is the central one, later ones are merged later.
    pub image: u16,
    /// 1 / depth from the layered image's centre of projection, 1/m; positive.
    pub disparity: f32,
    /// Area of the surface that its pixel shows in its own image, m².
    pub area_m2: f32,
}

/// What became of samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MergeFigures {
    /// Samples of all reference images.
    pub offered: u64,
    /// Of them in the layered image.
    pub kept: u64,
    /// Left out for one of smaller area, or of the central image, that was there.
    pub lost: u64,
    /// Replaced by a later one of smaller area.
    pub replaced: u64,
    /// Before the central image's sample.
    pub before_central: u64,
    /// Beside the layered image, or beyond its last layer.
    pub outside: u64,
}

impl MergeFigures {
    /// Adds another image's.
    pub fn add(&mut self, o: &Self) {
        self.offered += o.offered;
        self.kept += o.kept;
        self.lost += o.lost;
        self.replaced += o.replaced;
        self.before_central += o.before_central;
        self.outside += o.outside;
    }
}

/// Whether two samples are at a similar depth: their depths differ by at most this share of the
/// larger.
pub fn is_similar(a: &Offer, b: &Offer, same_depth: f64) -> bool {
    f64::from((a.disparity - b.disparity).abs()) <= same_depth * f64::from(a.disparity.max(b.disparity))
}

/// Positions in `offers` of the samples that stay in one place, nearest first. `offers` come by
/// image, ascending.
pub fn merge_place(offers: &[Offer], same_depth: f64, figures: &mut MergeFigures) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for (i, o) in offers.iter().enumerate() {
        if o.image > 0 {
            let before = |k: &&usize| offers[**k].image == 0 && o.disparity > offers[**k].disparity;
            let hides_central = kept.iter().find(before).is_some_and(|k| !is_similar(o, &offers[*k], same_depth));
            if hides_central {
                figures.before_central += 1;
                continue;
            }
            let conflicts = |k: &usize| offers[*k].image != o.image && is_similar(o, &offers[*k], same_depth);
            let stands = |k: &usize| offers[*k].image == 0 || offers[*k].area_m2 <= o.area_m2;
            if kept.iter().any(|k| conflicts(k) && stands(k)) {
                figures.lost += 1;
                continue;
            }
            let there = kept.len();
            kept.retain(|k| !conflicts(k));
            figures.replaced += (there - kept.len()) as u64;
        }
        kept.push(i);
    }
    // Stable: of equals the earlier image comes first, so that nothing pushes the central sample
    // back.
    kept.sort_by(|a, b| offers[*b].disparity.total_cmp(&offers[*a].disparity));
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn offer(image: u16, depth_m: f32, area_m2: f32) -> Offer {
        Offer { image, disparity: 1.0 / depth_m, area_m2 }
    }

    fn merged(offers: &[Offer]) -> (Vec<usize>, MergeFigures) {
        let mut figures = MergeFigures::default();
        (merge_place(offers, 0.02, &mut figures), figures)
    }

    #[test]
    fn each_rule_on_its_own() {
        // Another depth is another layer, in order of depth.
        let (kept, _) = merged(&[offer(0, 4.0, 1.0), offer(1, 8.0, 1.0), offer(2, 6.0, 1.0)]);
        assert_eq!(kept, [0, 2, 1]);
        // Of two at the same depth the smaller area stays, whichever came first.
        let (kept, figures) = merged(&[offer(1, 4.0, 2.0), offer(2, 4.04, 1.0)]);
        assert_eq!((kept, figures.replaced, figures.lost), (vec![1], 1, 0));
        let (kept, figures) = merged(&[offer(1, 4.0, 1.0), offer(2, 4.04, 2.0)]);
        assert_eq!((kept, figures.replaced, figures.lost), (vec![0], 0, 1));
        // Two of one image are both kept, even when both replace one of another.
        assert_eq!(merged(&[offer(1, 4.0, 1.0), offer(1, 4.01, 2.0)]).0, [0, 1]);
        let (kept, figures) = merged(&[offer(1, 4.0, 3.0), offer(2, 4.02, 1.0), offer(2, 4.01, 2.0)]);
        assert_eq!((kept, figures.replaced), (vec![2, 1], 1));
        // The central image's stays, however large, and nothing comes before it.
        let (kept, figures) =
            merged(&[offer(0, 4.0, 9.0), offer(1, 4.01, 1.0), offer(2, 3.0, 1.0), offer(3, 5.0, 1.0)]);
        assert_eq!((kept, figures.lost, figures.before_central), (vec![0, 3], 1, 1));
        assert!(merged(&[]).0.is_empty());
    }

    /// The rules word by word over a list of what is there, looked through anew for each sample.
    fn oracle(offers: &[Offer], same_depth: f64) -> Vec<usize> {
        let mut there: Vec<(usize, Offer)> = Vec::new();
        'next: for (number, new) in offers.iter().enumerate() {
            let (near, far) = (1.0 / f64::from(new.disparity), same_depth);
            let mut losers = Vec::new();
            for (at, old) in &there {
                let depth = 1.0 / f64::from(old.disparity);
                // |1/a - 1/b| <= s max(1/a, 1/b) is |a - b| <= s max(a, b).
                let alike = (near - depth).abs() <= far * near.max(depth);
                if new.image != 0 && old.image == 0 && near < depth && !alike {
                    continue 'next;
                }
                if alike && old.image != new.image {
                    if new.image != 0 && (old.image == 0 || !(new.area_m2 < old.area_m2)) {
                        continue 'next;
                    }
                    losers.push(*at);
                }
            }
            there.retain(|(at, _)| !losers.contains(at));
            there.push((number, *new));
        }
        let mut rest: Vec<usize> = there.iter().map(|t| t.0).collect();
        let mut sorted = Vec::new();
        while !rest.is_empty() {
            // Of equals the first.
            let best = (1..rest.len())
                .fold(0, |b, i| if offers[rest[i]].disparity > offers[rest[b]].disparity { i } else { b });
            sorted.push(rest.remove(best));
        }
        sorted
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn places_merge_as_the_rules_say(raw in prop::collection::vec((0u16..5, 0u32..12, 1u32..5), 0..14)) {
            let mut raw = raw;
            raw.sort_by_key(|r| r.0);
            // One central sample at most: a pixel of its own image.
            let mut central = 0;
            raw.retain(|r| { central += u32::from(r.0 == 0); r.0 > 0 || central < 2 });
            // Depths apart by 1.3%, so that some are similar and none on the border.
            let offers: Vec<Offer> = raw.iter().map(|(image, step, area)| offer(*image, 1.013_f32.powi(*step as i32), *area as f32)).collect();
            let mut figures = MergeFigures::default();
            let kept = merge_place(&offers, 0.02, &mut figures);
            prop_assert_eq!(&kept, &oracle(&offers, 0.02));
            let gone = figures.lost + figures.replaced + figures.before_central;
            prop_assert_eq!(kept.len() as u64 + gone, offers.len() as u64);
            // What no order of steps may change.
            prop_assert!(kept.windows(2).all(|w| offers[w[0]].disparity >= offers[w[1]].disparity));
            if let Some(first) = offers.iter().position(|o| o.image == 0) {
                prop_assert_eq!(kept.first(), Some(&first));
            }
            for (n, a) in kept.iter().enumerate() {
                for b in &kept[..n] {
                    prop_assert!(offers[*a].image == offers[*b].image || !is_similar(&offers[*a], &offers[*b], 0.02));
                }
            }
        }
    }
}
