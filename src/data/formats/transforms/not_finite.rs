//! JSON as Python writes it when a number is none: `NaN` and `Infinity`, which no JSON parser takes.

/// A token that is no JSON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Token {
    /// Line in the file, from 1.
    pub line: usize,
    /// As it stands there.
    pub text: &'static str,
}

/// `text` with each `NaN` and `Infinity` outside of strings replaced by `null`, and what was replaced, in order.
pub(crate) fn blanked(text: &str) -> (String, Vec<Token>) {
    let (mut out, mut tokens) = (String::with_capacity(text.len()), Vec::new());
    let (mut rest, mut line, mut quoted) = (text, 1, false);
    while let Some(c) = rest.chars().next() {
        let token = ["NaN", "-Infinity", "Infinity"]
            .into_iter()
            .find(|t| !quoted && rest.starts_with(t));
        if let Some(text) = token {
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
        let (out, tokens) = blanked("{\"NaN\\\"NaN\": [1,\n NaN, -Infinity], \"b\": Infinity}");
        assert_eq!(out, "{\"NaN\\\"NaN\": [1,\n null, null], \"b\": null}");
        let found: Vec<_> = tokens.iter().map(|t| (t.line, t.text)).collect();
        assert_eq!(found, [(2, "NaN"), (2, "-Infinity"), (2, "Infinity")]);
    }
}
