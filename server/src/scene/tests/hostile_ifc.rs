//! Bad IFC files.

use super::hostile::Case;
use super::ifc_text::{MILLI, box_records, building, columns, file, wall};

fn ifc(name: &'static str, says: &'static str, text: impl AsRef<[u8]> + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.ifc", text.as_ref()))
}

/// The building with a part of its text replaced.
fn with(name: &'static str, says: &'static str, from: &str, to: &str) -> Case {
    let text = building();
    assert!(text.contains(from), "{name}: {from}");
    ifc(name, says, text.replace(from, to))
}

/// The wall alone, with a part of its text replaced, so that nothing else is drawn.
fn alone(name: &'static str, says: &'static str, from: &str, to: &str) -> Case {
    let text = file(&wall());
    assert!(text.contains(from), "{name}: {from}");
    ifc(name, says, text.replace(from, to))
}

/// Maps that place each other ten times, nine deep.
fn nested() -> String {
    let mut records = box_records(100, [0.0; 3], [300.0; 3]);
    let mut of = 104;
    for level in 0..9u32 {
        let at = 1000 + 100 * level;
        let items: Vec<String> = (0..10).map(|k| format!("#{}", at + 10 + k)).collect();
        records += &format!("#{at}=IFCREPRESENTATIONMAP(#11,#{of});\n");
        for item in &items {
            records += &format!("{item}=IFCMAPPEDITEM(#{at},#111);\n");
        }
        of = at + 1;
        let items = items.join(",");
        records += &format!("#{of}=IFCSHAPEREPRESENTATION(#10,'Body','MappedRepresentation',({items}));\n");
    }
    records += "#111=IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,#12,1.,$);\n";
    records += &format!("#200=IFCPRODUCTDEFINITIONSHAPE($,$,(#{of}));\n");
    records += "#201=IFCCOLUMN('8hOSvn6df7F8_7GcBWlRGQ',$,'many',$,$,#15,#200,$,$);\n";
    file(&records)
}

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    let half = |text: String| text[..text.len() / 2].to_owned();
    vec![
        ifc("IFC of a header", "schema", "ISO-10303-21;\nHEADER;\n"),
        ifc("IFC cut off", "ends amid", half(building())),
        ifc("IFC without records", "no records", "ISO-10303-21;HEADER;FILE_SCHEMA(('IFC4'));ENDSEC;DATA;ENDSEC;"),
        ifc("IFC of the frame alone", "no product", file("")),
        with("IFC of another schema", "STEP", "('IFC4')", "('AUTOMOTIVE_DESIGN')"),
        with("IFC of a later schema", "IFC 4.3", "('IFC4')", "('IFC9')"),
        with(
            "IFC unit of nothing",
            "unit",
            MILLI,
            "#6=IFCCONVERSIONBASEDUNIT(#9,.LENGTHUNIT.,'x',#8);\n#8=IFCMEASUREWITHUNIT(IFCLENGTHMEASURE(0.),#4);\n#9=IFCDIMENSIONALEXPONENTS(1,0,0,0,0,0,0);\n#4=IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.);",
        ),
        alone("IFC number of no f64", "no product", "4000.0,200.0", "1.E400,200.0"),
        alone("IFC number NaN", "no product", "4000.0,200.0", "NaN,200.0"),
        alone("IFC out of the world", "origin", "2000.0,100.0,0.0", "1.E30,100.0,0.0"),
        alone("IFC product without a shape", "no product", "#15,#25,$", "#15,$,$"),
        alone("IFC shape of nothing", "no product", "(#23)", "(#9999)"),
        alone("IFC solid of itself", "no product", "IFCEXTRUDEDAREASOLID(#22,", "IFCEXTRUDEDAREASOLID(#23,"),
        ifc("IFC maps in a circle", "circle", file(&columns()).replace("'SweptSolid',(#103)", "'SweptSolid',(#112)")),
        ifc("IFC maps of a billion", "triangles in one product", nested()),
    ]
}
