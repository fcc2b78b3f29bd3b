//! Edits of lists.

use openusd::sdf::ListOp;

/// What `list` adds, in whichever way.
pub(super) fn added<T: Default + Clone + PartialEq>(list: &ListOp<T>) -> impl Iterator<Item = &T> {
    let lists = [
        &list.explicit_items,
        &list.prepended_items,
        &list.added_items,
        &list.appended_items,
    ];
    lists.into_iter().flatten()
}
