//! Which instances share a prototype.

use openusd::pcp::{ArcType, LayerId, Node, PrimIndex};
use openusd::sdf;
use openusd::usd::Stage;

/// What instances must have in common to share a prototype: the sites that arcs on the instance itself bring in
/// (`Pcp_InstanceKey`). The crate's own key includes variants of the instance's ancestors, and so shares too little.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct InstanceKey(Vec<(ArcType, LayerId, String, u64, u64)>);

impl InstanceKey {
    /// The key of the instance at `path`.
    pub(super) fn of(stage: &Stage, path: &sdf::Path) -> anyhow::Result<Self> {
        let index = stage.prim_index(path.clone()).graph()?;
        let nodes = index
            .nodes()
            .filter(|node| node.has_specs() && is_own(&index, node));
        let parts = nodes.map(|node| {
            let offset = node.map_to_root().time_offset();
            let (layer, path) = (node.layer_id(), node.path().to_string());
            (
                node.arc(),
                layer,
                path,
                offset.offset.to_bits(),
                offset.scale.to_bits(),
            )
        });
        Ok(Self(parts.collect()))
    }
}

/// True if an arc of the prim itself, not of an ancestor, brings `node` in. (Below the pseudo-root the instance's own
/// site hangs on an arc too: instances at the top of a stage differ in it and share nonetheless.)
fn is_own(index: &PrimIndex, node: &Node) -> bool {
    let mut at = Some(node);
    while let Some(node) = at {
        let parent = node.parent().filter(|_| node.arc() != ArcType::Root);
        let parent = parent.map(|parent| index.node(parent));
        if parent.is_some_and(|parent| {
            parent.path().prim_element_count() <= usize::from(node.namespace_depth())
        }) {
            return true;
        }
        at = parent;
    }
    false
}
