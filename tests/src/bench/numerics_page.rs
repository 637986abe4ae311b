//! The page and the tables of the numerical cases.

use super::numerics::Case;
use crate::page::STYLE;
use crate::plot::{escape, number};
use std::fmt::Write as _;

const HEADS: [&str; 8] = ["case", "what", "bound", "worst", "cases", "", "oracle", "why"];

/// A value with three digits, however small.
fn small(v: f64) -> String {
    if v == 0.0 || (1e-3..1e4).contains(&v) { number(v) } else { format!("{v:.2e}") }
}

fn cells(c: &Case) -> [String; 8] {
    [
        c.name.into(),
        c.what.into(),
        small(c.bound),
        small(c.worst),
        number(c.cases as f64),
        if c.holds() { "holds" } else { "BROKEN" }.into(),
        c.oracle.into(),
        c.why.into(),
    ]
}

/// For a terminal.
pub fn table(cases: &[Case]) -> String {
    let mut out = String::new();
    for c in cases {
        let [name, what, bound, worst, n, holds, ..] = cells(c);
        let _ = writeln!(out, "{holds:<6} {name}: {what} at most {bound}, worst of {n} cases {worst}");
    }
    out
}

/// The table as CSV.
pub fn csv(cases: &[Case]) -> String {
    let mut out = HEADS.join(",") + "\n";
    for c in cases {
        out += &(cells(c).map(|cell| format!("\"{}\"", cell.replace('"', "\"\""))).join(",") + "\n");
    }
    out
}

/// The page.
pub fn page(cases: &[Case], command: &str) -> String {
    let mut h = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Hard numerical cases</title><style>{STYLE}main{{max-width:1500px}}</style><main><h1>Hard numerical cases</h1>\
         <p class=\"lead\">{} of {} bounds hold.</p><table><tr>",
        cases.iter().filter(|c| c.holds()).count(),
        cases.len()
    );
    HEADS.iter().for_each(|head| {
        let _ = write!(h, "<th>{head}</th>");
    });
    for c in cases {
        h.push_str("</tr><tr>");
        cells(c).iter().for_each(|cell| {
            let _ = write!(h, "<td>{}</td>", escape(cell));
        });
    }
    let _ = write!(h, "</tr></table><h2>Command</h2><pre>{}</pre></main>", escape(command));
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_bound_is_seen() {
        let case =
            Case { name: "a \"b\"", what: "px", bound: 1e-4, why: "<because>", oracle: "f64", cases: 10, worst: 2e-4 };
        let kept = Case { worst: 1e-5, ..case.clone() };
        let all = [case, kept];
        assert!(table(&all).lines().next().is_some_and(|l| l.starts_with("BROKEN") && l.contains("2.00e-4")));
        assert!(csv(&all).contains("\"a \"\"b\"\"\""));
        let page = page(&all, "ldi-bench numerics");
        assert!(page.contains("1 of 2 bounds hold") && page.contains("&lt;because&gt;"));
    }
}
