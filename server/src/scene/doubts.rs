//! What speaks against the units and axes by which a scene was read.
//!
//! In: how the scene was asked for, and the scene. Out: sentences for a person, each with a remedy.
//! A doubt is no error: a model of a city in millimetres is one, and so is a statue of 20 cm.

use super::{BuiltinSpec, FileSpec, Scene};
use glam::{DMat3, DVec3};

/// With `?up=z`, surfaces that face along Z have at least so many times the area of those that face
/// up or down: floors lie on their side.
const SIDEWAYS: f64 = 1.5;

/// All doubts about a scene that was asked for by `specs`.
pub fn doubts(specs: &[String], scene: &Scene) -> Vec<String> {
    let is_file = |s: &&String| BuiltinSpec::parse(s).is_none();
    let files: Vec<FileSpec> = specs.iter().filter(is_file).filter_map(|s| FileSpec::parse(s).ok()).collect();
    let unit = files.iter().find_map(|f| f.unit);
    let mut found: Vec<String> = unit_doubt(scene.bounds().size().max_element(), unit).into_iter().collect();
    if files.iter().any(|f| f.is_z_up) {
        let facing = facing_areas(scene);
        found.extend(axis_doubt(&facing));
    }
    found
}

/// What speaks against the unit in a scene's longest side, if anything: towns are smaller than the
/// larger bound, and nobody walks in less than the smaller one. `given`: the unit that was named.
fn unit_doubt(longest_m: f64, given: Option<&str>) -> Option<String> {
    let size = match longest_m {
        m if m > 5000.0 => format!("{:.0} km", m / 1000.0),
        m if m > 0.0 && m < 1.0 => format!("{:.0} mm", m * 1000.0),
        _ => return None,
    };
    Some(match given {
        None => format!(
            "the scene is {size} long; if its unit is not the metre, name it as in 'FILE?unit=mm' (or cm, in, ft)"
        ),
        Some(unit) => format!(
            "the scene is {size} long with ?unit={unit}; leave the unit out if the file is in metres, or name the one that it is in"
        ),
    })
}

/// What speaks against `?up=z` in the areas that face along each axis, m².
fn axis_doubt(facing: &DVec3) -> Option<String> {
    (facing.z > SIDEWAYS * facing.y).then(|| {
        format!(
            "with ?up=z the scene seems to lie on its side: {:.0} m² face along Z, and {:.0} m² up or down, as floors do; leave ?up=z out if the file has Y up, as glTF has by its standard",
            facing.z, facing.y
        )
    })
}

/// Area of all surfaces by the axis that they face along, m². Each instance costs as much as a
/// triangle; scales that differ along the axes are counted roughly.
fn facing_areas(scene: &Scene) -> DVec3 {
    let of_mesh: Vec<DMat3> = scene
        .meshes
        .iter()
        .map(|mesh| {
            let mut sum = DMat3::ZERO;
            for p in &mesh.primitives {
                for corners in &p.triangles {
                    let [a, b, c] = corners.map(|v| p.positions[v as usize].as_dvec3());
                    let across = (b - a).cross(c - a);
                    let area = across.length() / 2.0;
                    if area > 0.0 {
                        let normal = across / (2.0 * area);
                        sum += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * area;
                    }
                }
            }
            sum
        })
        .collect();
    let mut facing = DVec3::ZERO;
    for instance in &scene.instances {
        let world = instance.world_from_mesh.matrix3;
        let volume = world.determinant().abs();
        // Normals turn by the cofactors.
        let turn = world.inverse().transpose() * volume;
        let turned = turn * of_mesh[instance.mesh as usize] * turn.transpose() / volume.powf(2.0 / 3.0);
        facing += DVec3::new(turned.x_axis.x, turned.y_axis.y, turned.z_axis.z);
    }
    facing
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};
    use ldi_protocol::Aabb;

    #[test]
    fn sizes_that_no_walked_scene_has_are_doubted() {
        assert_eq!([12.0, 1.0, 5000.0, 0.0].map(|m| unit_doubt(m, None)), [const { None }; 4]);
        let doubt = |m, unit| unit_doubt(m, unit).expect("doubted");
        assert!(doubt(48_300.0, None).contains("48 km") && doubt(0.31, None).contains("310 mm"));
        assert!(doubt(48_300.0, None).contains("FILE?unit=mm"));
        let given = doubt(0.06, Some("mm"));
        assert!(given.contains("60 mm long with ?unit=mm; leave") && !given.contains("FILE?unit"), "{given}");
    }

    #[test]
    fn a_floor_on_its_side_is_doubted_if_z_was_said_to_be_up() {
        let floor = Aabb { min: DVec3::ZERO, max: DVec3::new(20.0, 0.5, 30.0) };
        let mut scene = scene_of(&[block(&floor)]);
        let facing = facing_areas(&scene);
        assert!((facing.y - 2.0 * 600.0).abs() < 1e-3 && (facing.z - 2.0 * 10.0).abs() < 1e-3, "{facing}");
        assert_eq!(doubts(&["floor.obj?up=z".into()], &scene), [""; 0]);
        // As `?up=z` turns it.
        scene.transform(&glam::DAffine3::from_mat3(DMat3::from_cols(DVec3::X, -DVec3::Z, DVec3::Y)));
        let said = doubts(&["floor.obj?up=z".into()], &scene);
        assert!(said.len() == 1 && said[0].contains("lie on its side"), "{said:?}");
        assert_eq!(doubts(&["floor.obj".into()], &scene), [""; 0]);
    }
}
