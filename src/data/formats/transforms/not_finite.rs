//! JSON as Python writes it for numbers that are not finite: `NaN` and `Infinity`, which no JSON parser takes.

/// A word that is no JSON.
pub(crate) struct Token {
    /// Line in the file, from 1.
    pub line: usize,
    pub text: &'static str,
}

/// `text` with each `NaN` and `Infinity` outside of strings replaced by `null`, and what was replaced, in order.
pub(crate) fn nulled(text: &str) -> (String, Vec<Token>) {
    let mut out = String::with_capacity(text.len());
    let mut tokens = Vec::new();
    let (mut rest, mut line, mut quoted) = (text, 1, false);
    while let Some(c) = rest.chars().next() {
        let mut words = ["NaN", "-Infinity", "Infinity"].into_iter();
        if let Some(text) = words.find(|word| !quoted && rest.starts_with(word)) {
            tokens.push(Token { line, text });
            out.push_str("null");
            rest = &rest[text.len()..];
            continue;
        }
        let mut taken = c.len_utf8();
        match c {
            '"' => quoted = !quoted,
            // An escaped character is taken together with its backslash.
            '\\' if quoted => taken += rest[taken..].chars().next().map_or(0, char::len_utf8),
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
        let (out, tokens) = nulled("{\"NaN\\\"NaN\": [1,\n NaN, -Infinity], \"b\": Infinity}");
        assert_eq!(out, "{\"NaN\\\"NaN\": [1,\n null, null], \"b\": null}");
        let found: Vec<_> = tokens.iter().map(|t| (t.line, t.text)).collect();
        assert_eq!(found, [(2, "NaN"), (2, "-Infinity"), (2, "Infinity")]);
    }
}
