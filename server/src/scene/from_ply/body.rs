//! The PLY body: numbers one after the other, in any of the three codings.

use super::super::error::Fault;
use super::super::files::shown;
use super::header::{Coding, Element, Header, Type};

const REMEDY: &str = "copy or export the file again, whole";

/// Reads numbers from front to back.
#[derive(Debug)]
pub(super) struct Body<'a> {
    coding: Coding,
    rest: &'a [u8],
    /// For messages: line of an ASCII file, offset in a binary one.
    line: usize,
    length: usize,
    line_end: u8,
    /// Whether each element has a line, so that words beyond its properties may be skipped.
    by_lines: bool,
    /// Elements with words beyond their properties.
    pub(super) with_more_words: usize,
}

impl<'a> Body<'a> {
    /// The bytes after the header.
    pub(super) fn new(file: &'a [u8], header: &Header) -> Self {
        let rest = &file[header.bytes..];
        let elements = header.elements.iter().fold(0u64, |n, e| n.saturating_add(e.count));
        let lines = || rest.split(|&b| b == header.line_end).filter(|l| !l.trim_ascii().is_empty()).count() as u64;
        Self {
            coding: header.coding,
            rest,
            line: header.lines + 1,
            length: file.len(),
            line_end: header.line_end,
            by_lines: header.coding == Coding::Ascii && lines() >= elements,
            with_more_words: 0,
        }
    }

    /// A fault here.
    pub(super) fn fault(&self, problem: impl Into<String>) -> Fault {
        let place = match self.coding {
            Coding::Ascii => format!("line {}", self.line),
            _ => format!("byte {}", self.length - self.rest.len()),
        };
        Fault::invalid(place, problem, REMEDY)
    }

    /// Refuses a count of elements that the rest of the file cannot hold, before anything is
    /// allocated for it.
    pub(super) fn check_room(&self, element: &Element) -> Result<(), Fault> {
        let least: u64 = element.properties.iter().map(|p| self.least_bytes(p.count.unwrap_or(p.item))).sum();
        if least == 0 && element.count > 0 {
            return Err(self.fault(format!("element {} has no properties", shown(&element.name))));
        }
        self.check_bytes(element.count, least, &format!("elements {}", shown(&element.name)))
    }

    fn check_bytes(&self, count: u64, each: u64, what: &str) -> Result<(), Fault> {
        // The last number of an ASCII file needs no separator.
        let room = self.rest.len() as u64 + 1;
        if count.checked_mul(each).is_none_or(|needed| needed > room) {
            return Err(
                self.fault(format!("{count} {what} do not fit into the {} bytes that are left", self.rest.len()))
            );
        }
        Ok(())
    }

    /// Bytes that a number takes at least: in ASCII, a digit and a separator.
    fn least_bytes(&self, kind: Type) -> u64 {
        if self.coding == Coding::Ascii { 2 } else { kind.size() as u64 }
    }

    /// The next number. All types fit an f64.
    pub(super) fn number(&mut self, kind: Type) -> Result<f64, Fault> {
        if self.coding == Coding::Ascii {
            return self.word(kind);
        }
        let size = kind.size();
        let Some((bytes, rest)) = self.rest.split_at_checked(size) else {
            return Err(self.fault("the file ends within an element"));
        };
        let mut word = [0; 8];
        word[..size].copy_from_slice(bytes);
        if self.coding == Coding::BigEndian {
            word[..size].reverse();
        }
        let n = u64::from_le_bytes(word);
        self.rest = rest;
        Ok(match kind {
            Type::I8 => f64::from(n as i8),
            Type::U8 => f64::from(n as u8),
            Type::I16 => f64::from(n as i16),
            Type::U16 => f64::from(n as u16),
            Type::I32 => f64::from(n as i32),
            Type::U32 => f64::from(n as u32),
            Type::F32 => f64::from(f32::from_bits(n as u32)),
            Type::F64 => f64::from_bits(n),
        })
    }

    fn word(&mut self, kind: Type) -> Result<f64, Fault> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(self.rest.len());
        self.line += self.rest[..start].iter().filter(|&&b| b == self.line_end).count();
        self.rest = &self.rest[start..];
        let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        if word.is_empty() {
            return Err(self.fault("the file ends within an element"));
        }
        let text = String::from_utf8_lossy(word);
        let number: f64 = text.parse().map_err(|_| self.fault(format!("{} is no number", shown(&text))))?;
        if !kind.is_float() && number.fract() != 0.0 {
            return Err(self.fault(format!("{} is no whole number", shown(&text))));
        }
        self.rest = rest;
        Ok(number)
    }

    /// Called after each element: skips words beyond its properties on its line.
    pub(super) fn end_element(&mut self) {
        if !self.by_lines {
            return;
        }
        let end = self.rest.iter().position(|&b| b == self.line_end).unwrap_or(self.rest.len());
        self.with_more_words += usize::from(!self.rest[..end].trim_ascii().is_empty());
        self.rest = &self.rest[end..];
    }

    /// The length of the list that comes next.
    pub(super) fn list_length(&mut self, count: Type, item: Type) -> Result<usize, Fault> {
        let n = self.number(count)?;
        if !(0.0..=f64::from(u32::MAX)).contains(&n) {
            return Err(self.fault(format!("a list of {n} items")));
        }
        self.check_bytes(n as u64, self.least_bytes(item), "list items")?;
        Ok(n as usize)
    }

    /// Reads over an element that is not used.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), Fault> {
        self.check_room(element)?;
        for _ in 0..element.count {
            for p in &element.properties {
                let n = match p.count {
                    Some(count) => self.list_length(count, p.item)?,
                    None => 1,
                };
                for _ in 0..n {
                    self.number(p.item)?;
                }
            }
            self.end_element();
        }
        Ok(())
    }
}
