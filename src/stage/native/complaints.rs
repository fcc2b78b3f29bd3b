//! The crate's composition errors → errors, where our stage would be smaller than Pixar's, or warnings, where Pixar's
//! too goes on with a warning.

use super::OTHER_DOOR;
use super::layer_files::EMPTY_SESSION;
use crate::diagnostics::Warning;
use crate::stage::Error;
use crate::stage::materialx::is_document;
use openusd::pcp;
use std::path::{Path, PathBuf};

/// Extensions every build of USD can read. A layer in another format needs a plug-in that the usd-core of `PyPI` lacks too.
const USD_EXTENSIONS: [&str; 4] = ["usd", "usda", "usdc", "usdz"];

/// What to do about `error` of the stage at `root`.
///
/// # Errors
/// When a layer that exists could not be read.
pub(super) fn judge(error: &pcp::Error, root: &Path) -> Result<Option<Warning>, Error> {
    // The crate names a stack of layers by its strongest, which is not the user's where it is the empty session layer.
    let named = |text: String| text.replace(EMPTY_SESSION, &root.to_string_lossy());
    let (kind, prim, message) = match error {
        pcp::Error::UnresolvedLayer {
            asset_path,
            introduced_by,
            site_path,
            ..
        } => (
            "missing-layer",
            site_path.to_string(),
            format!(
                "@{asset_path}@, used in {introduced_by}, does not exist; what it holds is missing from the stage"
            ),
        ),
        pcp::Error::UnresolvedSublayer {
            asset_path,
            introduced_by,
        } => (
            "missing-layer",
            introduced_by.clone(),
            format!(
                "sublayer @{asset_path}@ does not exist; what it holds is missing from the stage"
            ),
        ),
        pcp::Error::MalformedLayer {
            asset_path,
            reason,
            site_path,
            ..
        } => return malformed(asset_path, &named(reason.clone()), &site_path.to_string()),
        pcp::Error::MalformedSublayer {
            asset_path,
            introduced_by,
            reason,
        } => return malformed(asset_path, reason, &named(introduced_by.clone())),
        pcp::Error::ArcCycle(chain) => (
            "composition-cycle",
            chain.composing.to_string(),
            format!("{error}; the arc that closes the cycle is ignored"),
        ),
        pcp::Error::SublayerCycle { seen_layer, .. } => (
            "composition-cycle",
            seen_layer.clone(),
            format!("{error}; the sublayer that closes the cycle is ignored"),
        ),
        other => (
            "composition",
            root.display().to_string(),
            format!("{other}; the opinion is ignored"),
        ),
    };
    Ok(Some(Warning {
        kind: kind.to_owned(),
        prim: named(prim),
        message: named(message),
    }))
}

fn malformed(asset_path: &str, reason: &str, user: &str) -> Result<Option<Warning>, Error> {
    if is_usd(asset_path) {
        return Err(Error::Layer {
            path: PathBuf::from(asset_path),
            message: format!("{reason} (used by {user}); {OTHER_DOOR}"),
        });
    }
    // Its materials are read without composing it, and what cannot be read is reported there.
    if is_document(asset_path) {
        return Ok(None);
    }
    Ok(Some(Warning {
        kind: "missing-layer".to_owned(),
        prim: user.to_owned(),
        message: format!(
            "@{asset_path}@ is in a format that needs a USD plug-in; what it holds is missing from the stage"
        ),
    }))
}

fn is_usd(asset_path: &str) -> bool {
    let inner = openusd::ar::split_package_relative_path_inner(asset_path);
    let path = inner.as_ref().map_or(asset_path, |(_, inner)| inner);
    Path::new(path)
        .extension()
        .and_then(|extension| extension.to_str())
        .is_some_and(|extension| {
            USD_EXTENSIONS
                .iter()
                .any(|usd| usd.eq_ignore_ascii_case(extension))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usd_in_a_package_is_usd_and_materialx_is_not() {
        assert!(is_usd("/a/b.USDA"));
        assert!(is_usd("/a/b.usdz[c/d.usd]"));
        assert!(!is_usd("/a/b.mtlx"));
        assert!(!is_usd("/a/usd"));
    }
}
