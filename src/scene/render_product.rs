//! UsdRender settings, products and vars, flattened: products carry what they inherit.

/// One AOV of a product.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RenderVar {
    /// Prim name, the AOV's name by schema (`driver:parameters:aov:name` wins when authored).
    pub name: String,
    /// `sourceName`.
    pub source_name: String,
    /// `sourceType`: `raw`, `primvar`, `lpe`, `intrinsic`.
    pub source_type: String,
    /// `dataType`.
    pub data_type: String,
}

/// One image to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderProduct {
    /// Stage path.
    pub path: String,
    /// `productName`, or the prim's name + `.exr` where that is empty.
    pub name: String,
    /// `productType`; only `raster` can be written.
    pub product_type: String,
    /// Camera path.
    pub camera: Option<String>,
    /// Pixels.
    pub resolution: (u32, u32),
    /// Width over height of one pixel.
    pub pixel_aspect_ratio: f32,
    /// `aspectRatioConformPolicy`.
    pub aspect_ratio_conform_policy: String,
    /// `dataWindowNDC`: xmin, ymin, xmax, ymax.
    pub data_window_ndc: [f32; 4],
    /// AOVs in order.
    pub vars: Vec<RenderVar>,
}

/// A RenderSettings prim.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderSettings {
    /// Stage path.
    pub path: String,
    /// Camera path.
    pub camera: Option<String>,
    /// Pixels.
    pub resolution: (u32, u32),
    /// `includedPurposes`.
    pub included_purposes: Vec<String>,
    /// `materialBindingPurposes`.
    pub material_binding_purposes: Vec<String>,
    /// Products in order.
    pub products: Vec<RenderProduct>,
}
