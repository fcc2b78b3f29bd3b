//! placeholder
pub(super) fn check(_bytes: &[u8]) -> Result<(), String> { Ok(()) }
