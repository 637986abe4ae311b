//! The PLY header: which elements follow, with which properties, in which coding.

use super::super::error::Fault;
use super::super::files::shown;
use super::super::limits::Limits;
use super::super::text;

/// How the body is coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coding {
    /// Words separated by white space.
    Ascii,
    /// Least significant byte first.
    LittleEndian,
    /// Most significant byte first.
    BigEndian,
}

/// A number's type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Type {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl Type {
    /// Bytes in a binary file.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What a colour of this type is divided by: integers are fractions of their largest value.
    pub(super) fn largest(self) -> f64 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32_767.0,
            Self::U16 => 65_535.0,
            Self::I32 => f64::from(i32::MAX),
            Self::U32 => f64::from(u32::MAX),
            Self::F32 | Self::F64 => 1.0,
        }
    }

    /// Whether it is one of the floats.
    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    fn parse(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// A property: a number, or a list with a count before it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    /// Name.
    pub(super) name: String,
    /// Type of the number, or of the list's items.
    pub(super) item: Type,
    /// Type of the list's count.
    pub(super) count: Option<Type>,
}

/// A kind of element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    /// `vertex`, `face` or another.
    pub(super) name: String,
    /// How many follow, as the header claims.
    pub(super) count: u64,
    /// In the order of the body.
    pub(super) properties: Vec<Property>,
}

/// A parsed header.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// How the body is coded.
    pub(super) coding: Coding,
    /// In the order of the body.
    pub(super) elements: Vec<Element>,
    /// `comment TextureFile`, as point cloud tools write it; faces may name them by number.
    pub(super) textures: Vec<String>,
    /// Comments that name a texture and say no name.
    pub(super) unnamed_textures: usize,
    /// Bytes of the header.
    pub(super) bytes: usize,
    /// Lines of the header.
    pub(super) lines: usize,
    /// What ends a line: a line feed, or as on old Macs a carriage return alone.
    pub(super) line_end: u8,
}

const REMEDY: &str = "export the file again";

/// Parses a header.
pub(super) fn parse(bytes: &[u8], limits: &Limits) -> Result<Header, Fault> {
    if !bytes.starts_with(b"ply") {
        return Err(Fault::invalid("line 1", "the file does not start with the word ply", REMEDY));
    }
    let window = &bytes[..bytes.len().min(limits.ply_header_bytes as usize)];
    let first_end = bytes.iter().position(|b| matches!(b, b'\r' | b'\n')).unwrap_or(0);
    let line_end =
        if bytes[first_end..].starts_with(b"\r") && bytes.get(first_end + 1) != Some(&b'\n') { b'\r' } else { b'\n' };
    let (coding, elements, textures) = (Coding::Ascii, Vec::new(), Vec::new());
    let mut out = Header { coding, elements, textures, unnamed_textures: 0, bytes: 0, lines: 0, line_end };
    let mut coding = None;
    for raw in window.split_inclusive(|&b| b == line_end).filter(|line| line.ends_with(&[line_end])) {
        out.bytes += raw.len();
        out.lines += 1;
        let fault = |problem: String| Fault::invalid(format!("line {}", out.lines), problem, REMEDY);
        let text = text::line(raw);
        let words: Vec<&str> = text.split_whitespace().collect();
        match words[..] {
            ["ply"] if out.lines == 1 => {}
            _ if out.lines == 1 => return Err(fault("the file does not start with the word ply".into())),
            ["format", name, "1.0"] => {
                coding = Some(match name {
                    "ascii" => Coding::Ascii,
                    "binary_little_endian" => Coding::LittleEndian,
                    "binary_big_endian" => Coding::BigEndian,
                    _ => return Err(fault(format!("format {} is not known", shown(name)))),
                });
            }
            ["comment", word, ..] if word.eq_ignore_ascii_case("TextureFile") => {
                let path = text.split_once(word).map_or("", |(_, path)| text::unquoted(path));
                match path.is_empty() {
                    true => out.unnamed_textures += 1,
                    false => out.textures.push(path.to_owned()),
                }
            }
            ["comment", ..] | ["obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count.parse().map_err(|_| fault(format!("{} is no count", shown(count))))?;
                out.elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ..] => {
                let property = property(&words[1..])
                    .ok_or_else(|| fault(format!("property {} is malformed", shown(text.trim()))))?;
                let element = out.elements.last_mut().ok_or_else(|| fault("property before any element".into()))?;
                if element.properties.iter().any(|p| p.name == property.name) {
                    return Err(fault(format!(
                        "property {} stands twice in element {}",
                        shown(&property.name),
                        shown(&element.name)
                    )));
                }
                element.properties.push(property);
            }
            ["end_header"] => {
                out.coding = coding.ok_or_else(|| fault("no line says the format".into()))?;
                return Ok(out);
            }
            _ => return Err(fault(format!("{} is no line of a PLY header", shown(text.trim())))),
        }
    }
    let problem = format!("no end_header within {} bytes", window.len());
    Err(Fault::invalid(format!("line {}", out.lines), problem, REMEDY))
}

fn property(words: &[&str]) -> Option<Property> {
    match *words {
        ["list", count, item, name] => {
            let count = Type::parse(count).filter(|t| !t.is_float())?;
            Some(Property { name: name.into(), item: Type::parse(item)?, count: Some(count) })
        }
        [item, name] => Some(Property { name: name.into(), item: Type::parse(item)?, count: None }),
        _ => None,
    }
}
