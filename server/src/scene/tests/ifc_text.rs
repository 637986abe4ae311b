//! IFC files of a few records for tests: a wall with a doorway and its door, two columns of one
//! type, two spaces, in millimetres.

/// Identity of the wall.
pub(super) const WALL_GUID: &str = "1hOSvn6df7F8_7GcBWlRGQ";

/// Length unit millimetre.
pub(super) const MILLI: &str = "#6=IFCSIUNIT(*,.LENGTHUNIT.,.MILLI.,.METRE.);";

/// Project, units, context and axes.
const FRAME: &str = "\
#1=IFCPROJECT('0YvctVUKr0kugbFTf53O9L',$,'project',$,$,$,$,(#10),#5);
#5=IFCUNITASSIGNMENT((#6,#7));
#6=IFCSIUNIT(*,.LENGTHUNIT.,.MILLI.,.METRE.);
#7=IFCSIUNIT(*,.PLANEANGLEUNIT.,$,.RADIAN.);
#10=IFCGEOMETRICREPRESENTATIONCONTEXT($,'Model',3,1.E-5,#11,$);
#11=IFCAXIS2PLACEMENT3D(#12,$,$);
#12=IFCCARTESIANPOINT((0.,0.,0.));
#13=IFCDIRECTION((0.,0.,1.));
#14=IFCDIRECTION((0.,1.,0.));
#15=IFCLOCALPLACEMENT($,#11);
";

/// Records of an upright box at `#at` and after: `#at+5` is its product shape.
pub(super) fn box_records(at: u32, [x, y, z]: [f64; 3], [dx, dy, dz]: [f64; 3]) -> String {
    let n = |k: u32| at + k;
    format!(
        "#{}=IFCCARTESIANPOINT(({:?},{:?},{z:?}));
#{}=IFCAXIS2PLACEMENT3D(#{},$,$);
#{}=IFCRECTANGLEPROFILEDEF(.AREA.,$,$,{dx:?},{dy:?});
#{}=IFCEXTRUDEDAREASOLID(#{},#{},#13,{dz:?});
#{}=IFCSHAPEREPRESENTATION(#10,'Body','SweptSolid',(#{}));
#{}=IFCPRODUCTDEFINITIONSHAPE($,$,(#{}));
",
        n(0),
        x + dx / 2.0,
        y + dy / 2.0,
        n(1),
        n(0),
        n(2),
        n(3),
        n(2),
        n(1),
        n(4),
        n(3),
        n(5),
        n(4)
    )
}

/// A file of IFC 4 with these records after the frame of `#1` to `#15`.
pub(super) fn file(records: &str) -> String {
    format!(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n\
         FILE_SCHEMA(('IFC4'));\nENDSEC;\nDATA;\n{FRAME}{records}ENDSEC;\nEND-ISO-10303-21;\n"
    )
}

/// The wall alone: 4000 x 200 x 3000.
pub(super) fn wall() -> String {
    box_records(20, [0.0, 0.0, 0.0], [4000.0, 200.0, 3000.0])
        + &format!("#27=IFCWALL('{WALL_GUID}',$,'north wall',$,$,#15,#25,$,$);\n")
}

/// A red style of the wall's solid.
pub(super) const RED: &str = "\
#80=IFCSTYLEDITEM(#23,(#81),$);
#81=IFCSURFACESTYLE('red',.BOTH.,(#82));
#82=IFCSURFACESTYLESHADING(#83,0.);
#83=IFCCOLOURRGB($,1.,0.5,0.);
";

/// A doorway in the wall, and a door in it.
pub(super) fn doorway() -> String {
    box_records(30, [1500.0, -100.0, 0.0], [1000.0, 400.0, 2100.0])
        + "#37=IFCOPENINGELEMENT('2hOSvn6df7F8_7GcBWlRGQ',$,'hole',$,$,#15,#35,$,$);
#38=IFCRELVOIDSELEMENT('3hOSvn6df7F8_7GcBWlRGQ',$,$,$,#27,#37);
" + &box_records(40, [1500.0, 80.0, 0.0], [1000.0, 40.0, 2100.0])
        + "#47=IFCDOOR('4hOSvn6df7F8_7GcBWlRGQ',$,'door',$,$,#15,#45,$,2100.,1000.,$,$,$);
#48=IFCRELFILLSELEMENT('5hOSvn6df7F8_7GcBWlRGQ',$,$,$,#37,#47);
"
}

/// Spaces before and behind the wall.
pub(super) fn spaces() -> String {
    box_records(50, [0.0, 200.0, 0.0], [4000.0, 3000.0, 3000.0])
        + "#57=IFCSPACE('6hOSvn6df7F8_7GcBWlRGQ',$,'hall',$,$,#15,#55,$,$,$,$);\n"
        + &box_records(60, [0.0, -3000.0, 0.0], [4000.0, 3000.0, 3000.0])
        + "#67=IFCSPACE('7hOSvn6df7F8_7GcBWlRGQ',$,'yard',$,$,#15,#65,$,$,$,$);\n"
}

/// Two columns, 300 x 300 x 3000, that place one map: at x of 5 m, and at 7 m turned by 90 degrees.
pub(super) fn columns() -> String {
    box_records(100, [0.0, 0.0, 0.0], [300.0, 500.0, 3000.0])
        + "#110=IFCREPRESENTATIONMAP(#11,#104);
#111=IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,#12,1.,$);
#112=IFCMAPPEDITEM(#110,#111);
#113=IFCSHAPEREPRESENTATION(#10,'Body','MappedRepresentation',(#112));
#114=IFCPRODUCTDEFINITIONSHAPE($,$,(#113));
#115=IFCCARTESIANPOINT((5000.,0.,0.));
#116=IFCAXIS2PLACEMENT3D(#115,$,$);
#117=IFCLOCALPLACEMENT(#15,#116);
#118=IFCCOLUMN('8hOSvn6df7F8_7GcBWlRGQ',$,'left',$,$,#117,#114,$,$);
#122=IFCMAPPEDITEM(#110,#111);
#123=IFCSHAPEREPRESENTATION(#10,'Body','MappedRepresentation',(#122));
#124=IFCPRODUCTDEFINITIONSHAPE($,$,(#123));
#125=IFCCARTESIANPOINT((7000.,0.,0.));
#126=IFCAXIS2PLACEMENT3D(#125,#13,#14);
#127=IFCLOCALPLACEMENT(#15,#126);
#128=IFCCOLUMN('9hOSvn6df7F8_7GcBWlRGQ',$,'right',$,$,#127,#124,$,$);
"
}

/// All of it.
pub(super) fn building() -> String {
    file(&[&wall(), RED, &doorway(), &spaces(), &columns()].map(|r| r.to_owned()).concat())
}
