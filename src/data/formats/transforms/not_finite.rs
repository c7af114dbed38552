//! JSON as Python writes it for numbers that are not finite: `NaN` and `Infinity`, which no JSON parser takes.

/// A word that is not valid JSON.
pub(crate) struct Token {
    /// Line in the file, from 1.
    pub line: usize,
    pub text: &'static str,
}

/// `text` with each `NaN` and `Infinity` outside of strings replaced by a string that names it and its line, and what was
/// replaced, in order.
pub(crate) fn quoted(text: &str) -> (String, Vec<Token>) {
    let mut out = String::with_capacity(text.len());
    let mut tokens = Vec::new();
    let mut rest = text;
    let mut line = 1;
    let mut in_string = false;
    while let Some(c) = rest.chars().next() {
        let mut words = ["NaN", "-Infinity", "Infinity"].into_iter();
        if let Some(text) = words.find(|word| !in_string && rest.starts_with(word)) {
            tokens.push(Token { line, text });
            out.push_str(&format!("\"{text} in line {line}\""));
            rest = &rest[text.len()..];
            continue;
        }
        let mut taken = c.len_utf8();
        match c {
            '"' => in_string = !in_string,
            // An escaped character is taken together with its backslash.
            '\\' if in_string => taken += rest[taken..].chars().next().map_or(0, char::len_utf8),
            '\n' => line += 1,
            _ => {}
        }
        out.push_str(&rest[..taken]);
        rest = &rest[taken..];
    }
    (out, tokens)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strings_stay_as_they_are() {
        let (out, tokens) = quoted("{\"NaN\\\"NaN\": [1,\n NaN, -Infinity], \"b\": Infinity}");
        let nan = "\"NaN in line 2\"";
        let [minus, plus] = ["\"-Infinity in line 2\"", "\"Infinity in line 2\""];
        assert_eq!(
            out,
            format!("{{\"NaN\\\"NaN\": [1,\n {nan}, {minus}], \"b\": {plus}}}")
        );
        let found: Vec<_> = tokens.iter().map(|t| (t.line, t.text)).collect();
        assert_eq!(found, [(2, "NaN"), (2, "-Infinity"), (2, "Infinity")]);
    }
}
