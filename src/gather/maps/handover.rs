//! Which receivers maps cannot judge.

use super::{MapsPlan, MapsSettings, Visibility};
use crate::receivers::Receivers;

/// Fill `visibility.ambiguous`: receivers with too many uncertain verdicts.
pub(super) fn mark(
    _plan: &MapsPlan<'_>,
    _receivers: &Receivers,
    settings: &MapsSettings,
    visibility: &mut Visibility,
) {
    visibility.ambiguous = visibility
        .uncertain
        .iter()
        .map(|&share| share > settings.ambiguous)
        .collect();
}
