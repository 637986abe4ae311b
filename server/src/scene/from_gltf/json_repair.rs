//! JSON that is nearly glTF, made such: faults of writers that leave no doubt what is meant.
//!
//! In: the JSON text of a file that the parser refuses. Out: the text with whole numbers written
//! without a fraction, keys once (the last one counts), names in UTF-8, NaN and infinities as
//! zeros, members that may be empty and are left out, and without animations, which are not read.
//! What is still wrong is for the parser to name.

use serde_json::{Map, Value};

/// Longer texts are not repaired: the document is held twice meanwhile.
const MOST_BYTES: usize = 32 << 20;
/// Largest integer of which f64 knows all.
const WHOLE: f64 = 9_007_199_254_740_992.0;

/// The repaired text; None where it is no JSON at all.
pub(super) fn repaired(json: &[u8]) -> Option<Vec<u8>> {
    if json.len() > MOST_BYTES {
        return None;
    }
    let text = without_words(&String::from_utf8_lossy(json));
    let mut root: Value = serde_json::from_str(&text).ok()?;
    whole_numbers(&mut root);
    let fields = root.as_object_mut()?;
    if let Some(Value::Object(asset)) = fields.get_mut("asset")
        && let Some(Value::Number(n)) = asset.get("version")
    {
        let version = n.as_u64().map_or_else(|| n.to_string(), |n| format!("{n}.0"));
        asset.insert("version".into(), version.into());
    }
    for scene in objects(fields, "scenes") {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    }
    for animation in objects(fields, "animations") {
        animation.insert("channels".into(), Value::Array(Vec::new()));
        animation.insert("samplers".into(), Value::Array(Vec::new()));
    }
    for mesh in objects(fields, "meshes") {
        mesh.entry("primitives").or_insert_with(|| Value::Array(Vec::new()));
        for primitive in objects(mesh, "primitives") {
            primitive.entry("attributes").or_insert_with(|| Value::Object(Map::new()));
        }
    }
    serde_json::to_vec(&root).ok()
}

fn objects<'a>(of: &'a mut Map<String, Value>, list: &str) -> impl Iterator<Item = &'a mut Map<String, Value>> {
    of.get_mut(list).and_then(Value::as_array_mut).into_iter().flatten().filter_map(Value::as_object_mut)
}

/// Numbers such as 4.0 as 4. The parser bounds how deep this goes.
fn whole_numbers(value: &mut Value) {
    match value {
        Value::Number(n) => {
            if let Some(x) = n.as_f64().filter(|x| n.is_f64() && x.fract() == 0.0 && x.abs() < WHOLE) {
                *value = Value::from(x as i64);
            }
        }
        Value::Array(items) => items.iter_mut().for_each(whole_numbers),
        Value::Object(fields) => fields.values_mut().for_each(whole_numbers),
        _ => {}
    }
}

/// The text with words for numbers that are none replaced by 0, outside of strings.
fn without_words(text: &str) -> String {
    /// Longer ones before their own beginnings.
    const WORDS: [&str; 9] = ["-Infinity", "Infinity", "-inf", "inf", "-NaN", "NaN", "-nan(ind)", "-nan", "nan"];
    let mut out = String::with_capacity(text.len());
    let (mut quoted, mut escaped) = (false, false);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let may_start = !quoted && matches!(c, '-' | 'I' | 'N' | 'i' | 'n');
        if may_start && let Some(word) = WORDS.iter().find(|w| rest.starts_with(**w)) {
            out.push('0');
            rest = &rest[word.len()..];
            continue;
        }
        quoted ^= c == '"' && !escaped;
        escaped = quoted && c == '\\' && !escaped;
        out.push(c);
        rest = &rest[c.len_utf8()..];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(json: &[u8]) -> Value {
        serde_json::from_slice(&repaired(json).expect("is JSON")).expect("stays JSON")
    }

    #[test]
    fn writers_faults_are_mended() {
        assert_eq!(
            of(b"{\"a\": [4.0, 4.5, -1e3, 1e300], \"b\": 1, \"b\": 2}").to_string(),
            "{\"a\":[4,4.5,-1000,1e+300],\"b\":2}"
        );
        assert_eq!(of(b"{\"n\": \"W\xe4nde\"}")["n"], "W\u{fffd}nde");
        assert_eq!(
            of(b"{\"min\": [NaN, -Infinity, 1], \"n\": \"NaN \\\" inf\"}").to_string(),
            "{\"min\":[0,0,1],\"n\":\"NaN \\\" inf\"}"
        );
        assert_eq!(of(b"{\"asset\": {\"version\": 2.0}}")["asset"]["version"], "2.0");
        assert_eq!(of(b"{\"scenes\": [{}]}")["scenes"][0]["nodes"], serde_json::json!([]));
        let animations =
            b"{\"animations\": [{\"channels\": [{\"target\": {\"path\": \"pointer\"}}], \"samplers\": [1]}]}";
        assert_eq!(of(animations)["animations"][0]["channels"], serde_json::json!([]));
    }

    #[test]
    fn what_is_no_json_stays_so() {
        for text in [&b"{"[..], b"[1]", b"", b"{\"a\": 1}x", b"{\"a\" 1}"] {
            assert!(repaired(text).is_none(), "{text:?}");
        }
        assert!(repaired(&[b'['; 1_000_000]).is_none());
    }
}
