//! The instances of a cell: transforms and bundles once each, in the order of first use; then per
//! instance its cluster and the difference of its transform's number to that of the instance
//! before.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
    cell::{MAX_CLUSTERS, MAX_INSTANCES},
};
use crate::mesh::{ClusterInstance, ClusterRef};
use glam::DAffine3;
use std::collections::BTreeMap;

/// Writes the instances; the transforms must be finite.
pub(super) fn encode_instances(w: &mut Writer, instances: &[ClusterInstance]) -> Result<(), CodecError> {
    let mut transforms: Vec<[f64; 12]> = Vec::new();
    let mut transform_numbers = BTreeMap::new();
    let mut bundles: Vec<u32> = Vec::new();
    let mut bundle_numbers = BTreeMap::new();
    let mut list = Vec::new();
    let mut last_transform = 0;
    for instance in instances {
        let t = instance.world_from_mesh.to_cols_array();
        if t.iter().any(|x| !x.is_finite()) {
            return Err(CodecError::range("transform", "not finite", "instances need finite transforms"));
        }
        let transform = *transform_numbers.entry(t.map(f64::to_bits)).or_insert_with(|| {
            transforms.push(t);
            transforms.len() as i64 - 1
        });
        match instance.cluster {
            ClusterRef::Own(k) => put_varint(&mut list, u64::from(k) << 1),
            ClusterRef::Shared { chunk, cluster } => {
                let bundle = *bundle_numbers.entry(chunk).or_insert_with(|| {
                    bundles.push(chunk);
                    bundles.len() as u64 - 1
                });
                put_varint(&mut list, bundle << 1 | 1);
                put_varint(&mut list, cluster.into());
            }
        }
        put_varint(&mut list, zigzag(transform - last_transform));
        last_transform = transform;
    }
    w.varint(transforms.len() as u64);
    // Byte k of all numbers together: exponents and high bits repeat.
    let bytes: Vec<[u8; 8]> = transforms.as_flattened().iter().map(|x| x.to_le_bytes()).collect();
    let transposed: Vec<u8> = (0..8).flat_map(|k| bytes.iter().map(move |b| b[k])).collect();
    w.section("transforms", &transposed)?;
    w.varint(bundles.len() as u64);
    bundles.iter().for_each(|&b| w.varint(b.into()));
    w.varint(instances.len() as u64);
    w.section("instances", &list)
}

/// Reads instances of a chunk that holds this many clusters of its own.
pub(super) fn decode_instances(r: &mut Reader<'_>, clusters: usize) -> Result<Vec<ClusterInstance>, CodecError> {
    let count = r.count("transforms", MAX_INSTANCES)?;
    let bytes = r.section_of("transforms", count * 96)?;
    let number = |i: usize| f64::from_le_bytes(std::array::from_fn(|k| bytes[k * count * 12 + i]));
    let transforms: Vec<DAffine3> =
        (0..count).map(|t| DAffine3::from_cols_array(&std::array::from_fn(|i| number(t * 12 + i)))).collect();
    if transforms.iter().any(|t| !t.is_finite()) {
        return Err(CodecError::range("transforms", "not finite", "instances need finite transforms"));
    }
    let bundles = r.count("bundles", MAX_INSTANCES)?;
    let bundles: Vec<u32> =
        (0..bundles).map(|_| Ok(r.varint("bundles", u32::MAX.into())? as u32)).collect::<Result<_, CodecError>>()?;
    let instances = r.count("instances", MAX_INSTANCES)?;
    // Three LEB128 numbers of at most five bytes.
    let list = r.section("instances", instances * 15)?;
    let mut list = Reader::new(&list);
    let mut transform = 0i64;
    let out = (0..instances)
        .map(|_| {
            let reference = list.varint("instance cluster", u64::from(u32::MAX) * 2)?;
            let which = (reference >> 1) as usize;
            let cluster = if reference & 1 == 0 {
                if which >= clusters {
                    return Err(CodecError::range("instance cluster", which, "no such cluster in the chunk"));
                }
                ClusterRef::Own(which as u32)
            } else {
                let chunk = *bundles.get(which).ok_or_else(|| {
                    CodecError::range("instance cluster", which, "no such bundle in the chunk's list")
                })?;
                ClusterRef::Shared { chunk, cluster: list.varint("instance cluster", MAX_CLUSTERS as u64 - 1)? as u32 }
            };
            transform += unzigzag(list.varint("instance transform", MAX_INSTANCES as u64 * 2)?);
            let world_from_mesh = *usize::try_from(transform)
                .ok()
                .and_then(|t| transforms.get(t))
                .ok_or_else(|| CodecError::range("instance transform", transform, "no such transform in the chunk"))?;
            Ok(ClusterInstance { cluster, world_from_mesh })
        })
        .collect::<Result<_, CodecError>>()?;
    list.finish("instances")?;
    Ok(out)
}
