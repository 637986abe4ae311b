//! How large a product becomes by items that it places again and again.
//!
//! A mapped item places a representation, which may place others: a few hundred bytes can ask for
//! billions of triangles in one product. [`Mapped::check`] bounds that before any shape is made:
//! items are weighed by the text that describes them, placed ones as often as they are placed.

use std::collections::{HashMap, HashSet};

use ifc_lite_core::{DecodedEntity, EntityIndex, build_entity_index};

use super::super::error::Fault;
use super::super::limits::Limits;

/// Representations within representations. The deepest known to be meant are three.
const MOST_DEEP: u32 = 32;
/// Placed items up to which a product is not weighed: their text alone bounds them well enough.
const FEW: u64 = 256;
/// Bytes of text of the shortest triangle, `(1,2,3),`.
const TRIANGLE_BYTES: u64 = 8;
/// Records that weighing may visit for each record of the file; items share points, hardly more.
const MOST_VISITS: u64 = 64;

/// Representations, and how they place each other; all by the numbers of their records.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// Items of a representation.
    items: HashMap<u32, Vec<u32>>,
    /// The map that a mapped item places.
    maps: HashMap<u32, u32>,
    /// The representation of a map.
    of_map: HashMap<u32, u32>,
}

/// What a representation comes to.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    /// Items, each as often as it is placed.
    placed: u64,
    /// Representations within it.
    height: u32,
}

impl Mapped {
    /// Takes a record of the scan; others than the three kinds are left.
    pub(super) fn add(&mut self, keyword: &str, record: impl FnOnce() -> Option<DecodedEntity>) {
        let is = |name: &str| keyword.eq_ignore_ascii_case(name);
        if !is("IFCMAPPEDITEM") && !is("IFCREPRESENTATIONMAP") && !is("IFCSHAPEREPRESENTATION") {
            return;
        }
        let Some(record) = record() else { return };
        if is("IFCMAPPEDITEM") {
            self.maps.extend(record.get_ref(0).map(|map| (record.id, map)));
        } else if is("IFCREPRESENTATIONMAP") {
            self.of_map.extend(record.get_ref(1).map(|of| (record.id, of)));
        } else {
            self.items.extend(record.get_refs(3).map(|items| (record.id, items)));
        }
    }

    /// Fails where representations nest too deep or in circles, or one may exceed the limits.
    pub(super) fn check(&self, bytes: &[u8], limits: &Limits) -> Result<(), Fault> {
        if self.maps.is_empty() {
            return Ok(());
        }
        let mut known = HashMap::new();
        let mut many = Vec::new();
        let mut representations: Vec<u32> = self.items.keys().copied().collect();
        representations.sort_unstable();
        for &representation in &representations {
            let sum = self.sum(representation, 0, &mut known)?;
            if sum.placed > FEW && sum.height > 0 {
                many.push(representation);
            }
        }
        if many.is_empty() {
            return Ok(());
        }
        let mut weights = Weights::new(bytes);
        for representation in many {
            let triangles = self.weight(representation, &mut weights) / TRIANGLE_BYTES;
            if triangles > limits.unique_triangles {
                let place = format!("#{representation}");
                return Err(Fault::too_large(place, "triangles in one product", triangles, limits.unique_triangles));
            }
        }
        Ok(())
    }

    /// The representation that an item places, if it places one.
    fn placed(&self, item: u32) -> Option<u32> {
        self.of_map.get(self.maps.get(&item)?).copied()
    }

    fn sum(&self, representation: u32, depth: u32, known: &mut HashMap<u32, Sum>) -> Result<Sum, Fault> {
        let too_deep = || {
            let problem = format!("representations place each other in a circle, or more than {MOST_DEEP} deep");
            Fault::broken(format!("#{representation}"), problem)
        };
        if depth > MOST_DEEP {
            return Err(too_deep());
        }
        if let Some(sum) = known.get(&representation) {
            return if depth + sum.height > MOST_DEEP { Err(too_deep()) } else { Ok(*sum) };
        }
        let mut out = Sum::default();
        for item in self.items.get(&representation).into_iter().flatten() {
            let inner = match self.placed(*item) {
                Some(placed) => {
                    let sum = self.sum(placed, depth + 1, known)?;
                    Sum { height: sum.height + 1, ..sum }
                }
                None => Sum { placed: 1, height: 0 },
            };
            out.placed = out.placed.saturating_add(inner.placed);
            out.height = out.height.max(inner.height);
        }
        known.insert(representation, out);
        Ok(out)
    }

    /// Bytes of the text of all items, each as often as it is placed. It ends, since [`Self::sum`]
    /// did.
    fn weight(&self, representation: u32, weights: &mut Weights) -> u64 {
        if let Some(weight) = weights.of_representations.get(&representation) {
            return *weight;
        }
        let items = self.items.get(&representation).map_or(&[][..], Vec::as_slice);
        let of_item = |item: &u32| match self.placed(*item) {
            Some(placed) => self.weight(placed, weights),
            None => weights.of_item(*item),
        };
        let weight = items.iter().map(of_item).fold(0, u64::saturating_add);
        weights.of_representations.insert(representation, weight);
        weight
    }
}

/// Bytes of records and of all that they refer to.
struct Weights<'a> {
    bytes: &'a [u8],
    index: EntityIndex,
    of_items: HashMap<u32, u64>,
    of_representations: HashMap<u32, u64>,
    visits_left: u64,
}

impl<'a> Weights<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let index = build_entity_index(bytes);
        let visits_left = MOST_VISITS.saturating_mul(index.len() as u64);
        Self { bytes, index, of_items: HashMap::new(), of_representations: HashMap::new(), visits_left }
    }

    fn of_item(&mut self, item: u32) -> u64 {
        if let Some(weight) = self.of_items.get(&item) {
            return *weight;
        }
        let (mut weight, mut seen, mut open) = (0u64, HashSet::from([item]), vec![item]);
        while let Some(record) = open.pop() {
            if self.visits_left == 0 {
                return u64::MAX;
            }
            self.visits_left -= 1;
            let text = self.index.get(&record).and_then(|&(start, end)| self.bytes.get(start..end));
            let Some(text) = text else { continue };
            weight += text.len() as u64;
            open.extend(references(text).filter(|r| seen.insert(*r)));
        }
        self.of_items.insert(item, weight);
        weight
    }
}

/// Numbers of the records that a record's text names; of its own as well. Text in quotes may add
/// some, which only makes it heavier.
fn references(text: &[u8]) -> impl Iterator<Item = u32> {
    text.split(|b| *b == b'#').skip(1).filter_map(|after| {
        let digits = after.iter().take_while(|b| b.is_ascii_digit()).count();
        std::str::from_utf8(&after[..digits]).ok()?.parse().ok()
    })
}
