//! What brings prims in, and what takes them out.

use super::Feature;

pub(super) const FEATURES: &[Feature] = &[
    Feature {
        name: "references, with list ops, offsets and paths mapped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(defaultPrim = "World"
upAxis = "Z"
metersPerUnit = 0.01
startTimeCode = 1
endTimeCode = 24
timeCodesPerSecond = 24)
def Xform "World" {
    def "A" (prepend references = @./asset.usda@) {
double speed = 3
}
    def "B" (references = [@./asset.usda@</Other>, @./asset.usda@ (offset = 10; scale = 2)]) {}
    def "C" (delete references = @./asset.usda@
prepend references = </World/A>) {
over "Geo" {
double radius = 7
}
}
}
"#,
            ),
            (
                "asset.usda",
                r#"#usda 1.0
(defaultPrim = "Asset"
timeCodesPerSecond = 48)
def Xform "Asset" (kind = "component"
prepend apiSchemas = ["MaterialBindingAPI"]) {
    double speed = 1
    double x.timeSamples = { 0: 0, 10: 10, 20: 40
}
    rel material:binding = </Asset/Looks/M> (bindMaterialAs = "strongerThanDescendants")
    def Sphere "Geo" {
double radius = 2
double radius.timeSamples = { 4: 1, 8: 3
}
rel to = [</Asset/Looks>, </Asset.speed>]
}
    def Scope "Looks" {
def Material "M" {
token outputs:surface.connect = </Asset/Looks/M/S.outputs:surface>
        def Shader "S" {
uniform token info:id = "UsdPreviewSurface"
token outputs:surface
}
}
}
}
def Xform "Other" {
double speed = 2
double y = 5
}
"#,
            ),
        ],
    },
    Feature {
        name: "sublayers with offsets: a default in a strong layer hides samples in a weak one",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./strong.usda@, @./weak.usda@ (offset = 5; scale = 0.5)])
over "P" {
double b.timeSamples = { 0: 1, 10: 2
}
double d = None
}
"#,
            ),
            (
                "strong.usda",
                r#"#usda 1.0
over "P" {
double a = 100
double e = 4
double e.timeSamples = { 0: 8
}
}
"#,
            ),
            (
                "weak.usda",
                r#"#usda 1.0
def Xform "P" {
double a.timeSamples = { 0: 1, 20: 2
}
double b = 7
double c.timeSamples = { 0: 0, 20: 20
}
double d = 9
    float2 blocked.timeSamples = { 0: (1, 1), 10: None, 20: (3, 3)
}
int held.timeSamples = { 0: 1, 20: 5
}
    double e = 5
timecode when = 3
}
"#,
            ),
        ],
    },
    Feature {
        name: "variants, nested and without a selection",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def Xform "P" (variants = {
string shape = "ball"
string nothing = "missing"
}
prepend variantSets = ["shape", "unselected", "nothing"]) {
    variantSet "shape" = {
        "ball" (prepend variantSets = "size"
variants = {
string size = "big"
}) {
def Sphere "Geo" {}
variantSet "size" = { "big" {
over "Geo" {
double radius = 9
}
}
"small" { }
}
}
        "box" {
def Cube "Geo" {}
}
    }
    variantSet "unselected" = { "a" {
def Cone "A" {}
}
"b" {
def Cone "B" {}
}
}
    variantSet "nothing" = { "c" {
def Cone "C" {}
}
}
}
"#,
        )],
    },
    Feature {
        name: "inherits and specializes",
        files: &[(
            "root.usda",
            r#"#usda 1.0
class "_Class" {
double a = 1
double b = 1
def Sphere "In" {
double radius = 4
}
}
class Xform "_Base" {
double b = 2
double c = 2
rel r = </_Base/X>
def "X" {}
}
def Xform "P" (inherits = </_Class>
specializes = </_Base>) {
over "In" {
token visibility = "invisible"
}
}
def Xform "Q" (specializes = </_Base>
references = </R>) { }
def "R" {
double c = 3
double b = 3
}
"#,
        )],
    },
    Feature {
        name: "payloads, inactive, over, class, untyped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def "P" (payload = @./p.usda@</Pay>) {
over "Off" (active = false) {}
over "New" {
def Sphere "Lost" {}
}
}
over "Only" {
def Sphere "Unseen" {}
}
class "Abstract" {
def Sphere "Unseen" {}
}
def "Many" (payload = [@./p.usda@</Pay>, @./p.usda@</Pay2>]) {}
"#,
            ),
            (
                "p.usda",
                r#"#usda 1.0
def Xform "Pay" {
def Sphere "Off" {}
def Sphere "On" (hidden = true) {}
}
def "Pay2" {
def Cube "Second" {}
}
"#,
            ),
        ],
    },
    Feature {
        name: "native instances: shared, nested, different variants, overridden at the root, targets inside and outside",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def Xform "World" {
    def "I1" (instanceable = true
references = @./asset.usda@) {
double3 xformOp:translate = (1, 0, 0)
uniform token[] xformOpOrder = ["xformOp:translate"]
rel out = </World/Free>
}
    def "I2" (instanceable = true
references = @./asset.usda@) {
over "Geo" {
double radius = 99
}
def Sphere "Ignored" {}
}
    def "I3" (instanceable = true
references = @./asset.usda@
variants = {
string v = "two"
}) { }
    def "Free" (instanceable = false
references = @./asset.usda@) {
over "Geo" {
double radius = 5
}
}
    def "NoArc" (instanceable = true) {
def Sphere "Seen" {}
}
    rel into = [</World/I1/Geo>, </World/I1>]
}
"#,
            ),
            (
                "asset.usda",
                r#"#usda 1.0
(defaultPrim = "Asset")
def Xform "Asset" (kind = "component"
variants = {
string v = "one"
}
prepend variantSets = "v") {
    double inherited = 1
    def Sphere "Geo" {
double radius = 1
rel material:binding = </Asset/Looks/M>
rel self = </Asset>
}
    def Scope "Looks" {
def Material "M" {
token outputs:surface.connect = </Asset/Looks/M/S.outputs:surface>
def Shader "S" {
token outputs:surface
}
}
}
    def "Nested1" (instanceable = true
references = </Leaf>) {}
    def "Nested2" (instanceable = true
references = </Leaf>) {}
    variantSet "v" = { "one" {
def Cube "One" {}
}
"two" {
def Cube "Two" {}
}
}
}
def Xform "Leaf" {
def Cone "Tip" {
rel up = </Leaf>
}
}
"#,
            ),
        ],
    },
    Feature {
        name: "reordering, relocates, names",
        files: &[(
            "root.usda",
            r#"#usda 1.0
reorder rootPrims = ["B", "A"]
def "A" {
reorder nameChildren = ["y", "x"]
def "x" {}
def "y" {}
reorder properties = ["q", "p"]
int p = 1
int q = 2
}
def "B" {
def "_under_score9" {
int a:b:c = 1
}
}
def "Élan" {}
"#,
        )],
    },
    Feature {
        name: "relocates",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(relocates = { </W/A/x>: </W/moved>
})
def "W" {
def "A" (references = @./a.usda@</A>) {}
}
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {
def Sphere "x" {
double radius = 3
rel t = </A/x>
}
rel t = </A/x>
}
"#,
            ),
        ],
    },
    Feature {
        name: "missing layers and paths are dropped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./gone.usda@])
def "P" (references = [@./gone.usda@, @./a.usda@</Nothing>, @./a.usda@, </Nowhere>]) {
int kept = 1
}
def "Q" (payload = @./gone.mtlx@) { }
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {}
"#,
            ),
        ],
    },
    Feature {
        name: "cycles are cut",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./root.usda@])
def "P" (references = @./b.usda@</B>) {
int kept = 1
}
def "Self" (references = </Self>) {
def "Child" {}
}
def "Up" {
def "Down" (references = </Up>) {
int n = 1
}
}
"#,
            ),
            (
                "b.usda",
                r#"#usda 1.0
def "B" (references = @./root.usda@</P>) {
int b = 2
}
"#,
            ),
        ],
    },
];
