//! Values, and how they are spelled and combined.

use super::Feature;

pub(super) const FEATURES: &[Feature] = &[
    Feature {
        name: "every kind of value",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def "P" {
    bool b = true
bool[] bs = [true, false]
uchar uc = 200
uchar[] ucs = [1, 255]
int i = -3
int[] is = [1, -2, 3]
    uint u = 4000000000
int64 l = -9007199254740993
int64[] ls = [1, -2]
uint64 ul = 7
    half h = 0.1
half[] hs = [0.1, 0.2]
float f = 0.1
float[] fs = [0.1, 2]
double d = 0.1
double[] ds = [0.1, 1e300]
    string s = "say \"hi\""
string[] ss = ["a", 'b']
token t = "tok"
token[] ts = ["x", "y"]
timecode tc = 4
    float2 f2 = (1, 2)
double2[] d2s = [(0.1, 2)]
half2 h2 = (0.1, 0.2)
int2 i2 = (3, 4)
texCoord2f[] st = [(0, 1), (2, 3)]
    float3 f3 = (1, 2, 3)
point3f[] p = [(1, 2, 3), (4, 5, 6)]
normal3h[] n = [(0.1, 0.2, 0.3)]
color3f c = (0.1, 0.2, 0.3)
vector3d v = (1, 2, 3)
int3 i3 = (1, 2, 3)
    float4 f4 = (1, 2, 3, 4)
color4f[] c4 = [(0.1, 0.2, 0.3, 0.4)]
double4 d4 = (1, 2, 3, 4)
half4[] h4 = [(1, 2, 3, 0.1)]
int4[] i4 = [(1, 2, 3, 4)]
    quatf q = (1, 2, 3, 4)
quath[] qh = [(1, 0, 0, 0.1)]
quatd qd = (0.5, 0.5, 0.5, 0.5)
    matrix4d m = ((1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12), (13, 14, 15, 16))
matrix4d[] ms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 6, 7, 1))]
    asset a = @./root.usda@
asset missing = @./nowhere.png@
asset[] as = [@a.png@, @b.png@]
float[] empty = []
float declared
    float nan = nan
float[] infs = [inf, -inf]
opaque o
double e = -1.5e-3
    float[] primvars:x = [1, 2, 3] (interpolation = "vertex"
elementSize = 3)
color3f[] primvars:c = [(1, 1, 1)] (colorSpace = "lin_rec709")
    int[] primvars:x:indices = [0]
}
"#,
        )],
    },
    Feature {
        name: "interpolation of every kind",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def "P" {
    half h.timeSamples = { 0: 0.1, 10: 7.3
}
float f.timeSamples = { 0: 0.1, 10: 7.3
}
double d.timeSamples = { 0: 0.1, 10: 7.3
}
    float3 v.timeSamples = { 0: (0, 1, 2), 10: (3, 5, 9)
}
point3f[] p.timeSamples = { 0: [(0, 1, 2)], 10: [(3, 5, 9)]
}
    quatf q.timeSamples = { 0: (1, 0, 0, 0), 10: (0, 1, 0, 0)
}
quath[] qs.timeSamples = { 0: [(1, 0, 0, 0)], 10: [(-0.6, 0.8, 0, 0)]
}
    quatd same.timeSamples = { 0: (1, 0, 0, 0), 10: (1, 0, 0, 0)
}
    matrix4d m.timeSamples = { 0: ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)), 10: ((2, 0, 0, 0), (0, 2, 0, 0), (0, 0, 2, 0), (1, 2, 3, 1))
}
    float[] grows.timeSamples = { 0: [1], 10: [2, 3]
}
int i.timeSamples = { 0: 1, 10: 9
}
token t.timeSamples = { 0: "a", 10: "b"
}
bool b.timeSamples = { 0: 0, 10: 1
}
    int2 held.timeSamples = { 0: (0, 0), 10: (5, 5)
}
double one.timeSamples = { 3: 4
}
double none.timeSamples = {}
asset a.timeSamples = { 0: @./root.usda@, 10: @./x.usda@
}
    half3[] hv.timeSamples = { 0: [(0.1, 0.2, 0.3)], 10: [(1, 2, 3)]
}
double block.timeSamples = { 0: 1, 2: None, 8: 5
}
double tail.timeSamples = { 0: 1, 20: None
}
}
"#,
        )],
    },
    Feature {
        name: "list ops of relationships, connections and API schemas across layers",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./weak.usda@])
def "P" (prepend apiSchemas = ["A1"] ) {
prepend rel r = </X>
append float in.connect = </Y.out>
delete rel gone = </B>
rel empty = None
}
"#,
            ),
            (
                "weak.usda",
                r#"#usda 1.0
def "P" (append apiSchemas = ["A2", "A1"]) {
rel r = [</A>, </X>]
float in.connect = [</A.out>]
rel gone = [</A>, </B>]
rel empty = </A>
float in = 3
rel declared
}
def "X" {}
"#,
            ),
        ],
    },
    Feature {
        name: "value clips",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def "M" (clips = {
dictionary default = {
asset[] assetPaths = [@./c1.usda@, @./c2.usda@]
asset manifestAssetPath = @./manifest.usda@
string primPath = "/M"
    double2[] active = [(0, 0), (10, 1)]
double2[] times = [(0, 0), (10, 10), (20, 20)]
}
}) {
double a
double still = 5
def "K" {
double b
}
}
"#,
            ),
            (
                "manifest.usda",
                r#"#usda 1.0
def "M" {
double a
def "K" {
double b
}
}
"#,
            ),
            (
                "c1.usda",
                r#"#usda 1.0
def "M" {
double a.timeSamples = { 0: 0, 10: 10
}
def "K" {
double b.timeSamples = { 0: 1, 10: 2
}
}
}
"#,
            ),
            (
                "c2.usda",
                r#"#usda 1.0
def "M" {
double a.timeSamples = { 10: 100, 20: 200
}
def "K" {
double b.timeSamples = { 10: 3, 20: 4
}
}
}
"#,
            ),
        ],
    },
    Feature {
        name: "variable expressions",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(expressionVariables = {
string WHICH = "a"
})
def "P" (references = @`"./${WHICH}.usda"`@</A>) {}
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {
int found = 1
}
"#,
            ),
        ],
    },
    Feature {
        name: "text that only Pixar's parser takes",
        files: &[(
            "root.usda",
            r#"#usda 1.0
( metersPerUnit = .01 )
def "P" ( active = True
kind = "component" ) {
    double a = .5
double b = 5.
float3 c = (.1, -.2, 0.)
float[] d = [1., .5, -.25, 2.e1]
asset e = "./root.usda"
asset[] f = ["a.png", 'b.png']
    // a comment
    double g.timeSamples = { .5: .25, 1.: 2.
}
    string h = "keep .5 and 5. and // this"
asset i = @./keep.5.@  # .5
}
def "Off" ( active = False ) {}
"#,
        )],
    },
];
