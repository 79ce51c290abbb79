use proto::kitchen::KitchenId;

/// The built-in or procedural kitchen with this number, as a command line gives it.
pub fn numbered(text: &str) -> Result<KitchenId, String> {
    let number: u32 = text.parse().map_err(|_| format!("`{text}` is not a kitchen number"))?;
    KitchenId::generated(number).map_err(|error| error.to_string())
}
