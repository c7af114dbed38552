//! Texts as tokens of CLIP.

/// Texts to token ids, with the vocabulary of all published CLIP models.
pub struct Tokenizer(instant_clip_tokenizer::Tokenizer);

impl Tokenizer {
    /// The tokenizer.
    pub fn new() -> Self {
        Self(instant_clip_tokenizer::Tokenizer::new())
    }

    /// Number of tokens that there are. The last two begin and end a text.
    pub fn vocabulary(&self) -> usize {
        usize::from(self.0.end_of_text().to_u16()) + 1
    }

    /// The tokens of a text in lower case, between those that begin and end it. OpenAI's code repairs broken Unicode and HTML
    /// entities first; this does not.
    pub fn tokens(&self, text: &str) -> Vec<u32> {
        let mut tokens = vec![self.0.start_of_text()];
        self.0.encode(text, &mut tokens);
        tokens.push(self.0.end_of_text());
        let ids = tokens.into_iter().map(|token| u32::from(token.to_u16()));
        ids.collect()
    }
}

impl Default for Tokenizer {
    fn default() -> Self {
        Self::new()
    }
}
