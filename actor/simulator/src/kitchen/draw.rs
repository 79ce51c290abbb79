use super::kitchen_key::KitchenKey;
use super::layout::FittedRoom;
use proto::random::Random;

/// A procedural kitchen takes another place among its set, with other quotas, after so many draws.
pub(super) const ATTEMPTS_EACH: u32 = 8;

/// A kitchen with the place among its set that it has at an attempt.
pub(super) fn at_attempt(kitchen_key: KitchenKey, attempt: u32) -> KitchenKey {
    if kitchen_key.id().is_procedural() { kitchen_key.edition(attempt / ATTEMPTS_EACH) } else { kitchen_key }
}

/// Lays a kitchen's room out, for the `attempt`th time from 0, before anything movable stands there; and the stream
/// that the rest is drawn from. The error is what found no place.
pub(super) fn draw_fitted(kitchen_key: KitchenKey, attempt: u32) -> Result<(FittedRoom, Random), String> {
    let kitchen_key = at_attempt(kitchen_key, attempt);
    let mut random = kitchen_key.room(attempt).stream();
    let fitted = FittedRoom::draw(kitchen_key, &mut random).map_err(|what| format!("a place for {what}"))?;
    Ok((fitted, random))
}
