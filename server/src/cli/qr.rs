//! The address of the server's page as a QR code.

use fast_qr::{QRBuilder, qr::QRCodeError};
use std::net::SocketAddr;

/// Light modules around the code, which readers need.
const QUIET: usize = 4;

/// What is shown of the page at `http`, with the code, line by line. `reached`: the addresses that
/// others type, the first one is shown.
pub(super) fn shown(http: SocketAddr, reached: &[SocketAddr]) -> Result<String, QRCodeError> {
    let address = reached.first().copied().unwrap_or(http);
    let url = format!("http://{address}/");
    let warning = if address.ip().is_loopback() {
        "\nonly this machine reaches it: --http 0.0.0.0:8080 lets others in"
    } else {
        ""
    };
    Ok(format!("{}{url}{warning}", code(&url)?))
}

/// The code in half blocks, light on dark as terminals are.
fn code(text: &str) -> Result<String, QRCodeError> {
    let code = QRBuilder::new(text).build()?;
    let is_light = |row: usize, column: usize| {
        let inside = |n: usize| (QUIET..QUIET + code.size).contains(&n);
        !(inside(row) && inside(column) && code[row - QUIET][column - QUIET].value())
    };
    let side = code.size + 2 * QUIET;
    let mut out = String::new();
    for row in (0..side).step_by(2) {
        for column in 0..side {
            out.push(match (is_light(row, column), row + 1 < side && is_light(row + 1, column)) {
                (true, true) => '\u{2588}',
                (true, false) => '\u{2580}',
                (false, true) => '\u{2584}',
                (false, false) => ' ',
            });
        }
        out.push('\n');
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_is_square_with_a_light_border() {
        let text = code("http://192.168.1.20:8080/").expect("short enough");
        let lines: Vec<Vec<char>> = text.lines().map(|l| l.chars().collect()).collect();
        let side = lines[0].len();
        assert!(lines.iter().all(|l| l.len() == side) && lines.len() == side.div_ceil(2));
        assert!(lines[0].iter().all(|c| *c == '\u{2588}') && lines.iter().all(|l| l[0] == '\u{2588}' || side % 2 == 1));
        // The finder patterns at both ends: seven dark modules, five light ones below them in the
        // same character.
        for first in [QUIET, side - QUIET - 7] {
            let finder: String = lines[QUIET / 2][first..first + 7].iter().collect();
            assert_eq!(finder, " \u{2584}\u{2584}\u{2584}\u{2584}\u{2584} ");
        }
    }

    #[test]
    fn a_page_for_this_machine_alone_is_told() {
        let [loopback, lan] =
            ["127.0.0.1:8080", "192.168.1.20:8080"].map(|a| a.parse::<SocketAddr>().expect("an address"));
        assert!(shown(loopback, &[]).expect("a code").contains("--http 0.0.0.0:8080"));
        let text = shown(loopback, &[lan]).expect("a code");
        assert!(text.ends_with("http://192.168.1.20:8080/"), "{text}");
    }
}
