//! Values of options that several programs take.

/// A share in percent, above 0.
pub fn percent(s: &str) -> Result<f64, String> {
    s.parse::<f64>()
        .ok()
        .filter(|p| *p > 0.0 && *p <= 100.0)
        .ok_or_else(|| format!("'{s}' is not a share in percent, above 0 and at most 100"))
}
