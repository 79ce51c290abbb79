//! The draws of a kitchen's layout, by attempt.

use super::layout::FittedRoom;
use super::lot::Lot;
use proto::random::Random;

/// A procedural kitchen takes another place among its set, with other quotas, after so many draws.
pub(super) const ATTEMPTS_EACH: u32 = 8;

/// A kitchen with the place among its set that it has at an attempt.
pub(super) fn at_attempt(lot: Lot, attempt: u32) -> Lot {
    if lot.id().is_procedural() { lot.edition(attempt / ATTEMPTS_EACH) } else { lot }
}

/// Lays a kitchen's room out, for the `attempt`th time from 0, before anything movable stands there; and the stream
/// that the rest is drawn from. The error is what found no place.
pub(super) fn draw_fitted(lot: Lot, attempt: u32) -> Result<(FittedRoom, Random), String> {
    let lot = at_attempt(lot, attempt);
    let mut random = lot.room(attempt).stream();
    let fitted = FittedRoom::draw(lot, &mut random).map_err(|what| format!("a place for {what}"))?;
    Ok((fitted, random))
}
