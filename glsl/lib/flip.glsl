// lib/flip.glsl -- what FLIP sees of a picture (Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating
// Images"; 2021, "Visualizing Errors in Rendered High Dynamic Range Images"), at 67.02 pixels a degree: 0.7 m before a
// screen 0.7 m and 3840 pixels wide. Both filters are separable; here are their halves, from the middle outwards.

const int REACH = 10;          // pixels: of the widest filter, 3 standard deviations
const int FINE_REACH = 6;      // of lightness and red-green, whose weights are under 1e-9 from here on
const int EDGE_REACH = 9;
const int BLOCK = 8;           // pixels in a row that one invocation works on: their filters share what they read
const int LINE = BLOCK + 2 * REACH;

// The eye's contrast sensitivity, for Y, Cx, and both Gaussians that Cz is the sum of (2020, eq. 4 and table 1).
const vec4 SENSITIVITY[11] = vec4[11](
    vec4(3.85760197e-01, 3.63269060e-01, 1.15442052e-01, 8.16927902e-02),
    vec4(2.41703701e-01, 2.39982343e-01, 1.09271658e-01, 7.48192441e-02),
    vec4(5.94539835e-02, 6.91881836e-02, 9.26697530e-02, 5.74780566e-02),
    vec4(5.74130195e-03, 8.70535185e-03, 7.04134240e-02, 3.70382116e-02),
    vec4(2.17656474e-04, 4.78016061e-04, 4.79357917e-02, 2.00196792e-02),
    vec4(3.23939989e-06, 1.14551402e-05, 2.92382469e-02, 9.07660411e-03),
    vec4(1.89273280e-08, 1.19800902e-07, 1.59782693e-02, 3.45182560e-03),
    vec4(0.0, 0.0, 7.82339264e-03, 1.10111701e-03),
    vec4(0.0, 0.0, 3.43200176e-03, 2.94630206e-04),
    vec4(0.0, 0.0, 1.34892206e-03, 6.61272162e-05),
    vec4(0.0, 0.0, 4.75021426e-04, 1.24492270e-05)
);
// A Gaussian as wide as the thinnest line that counts as an edge, its first derivative to the right, and its second.
const vec3 EDGES[10] = vec3[10](
    vec3(1.45257466e-01, 0.0, -2.98901543e-01),
    vec3(1.35950170e-01, -1.25649028e-01, -2.42699895e-01),
    vec3(1.11456043e-01, -2.06021713e-01, -1.07849334e-01),
    vec3(8.00405501e-02, -2.21927284e-01, 3.20540282e-02),
    vec3(5.03499550e-02, -1.86139463e-01, 1.17550389e-01),
    vec3(2.77441029e-02, -1.28209460e-01, 1.33767891e-01),
    vec3(1.33913655e-02, -7.42600939e-02, 1.05268697e-01),
    vec3(5.66189251e-03, -3.66301788e-02, 6.48457361e-02),
    vec3(2.09691561e-03, -1.55042342e-02, 3.27070975e-02),
    vec3(6.80272421e-04, -5.65854472e-03, 1.38061614e-02)
);

// Linear Rec. 709 to CIE XYZ in units of its white (D65), and back.
const mat3 XYZ_FROM_RGB = mat3(
    vec3(0.433895378, 0.212636822, 0.017752423), vec3(0.376242363, 0.715182982, 0.109465629),
    vec3(0.189862234, 0.072180196, 0.872781955)
);
const mat3 RGB_FROM_XYZ = mat3(
    vec3(3.080342063, -0.921178419, 0.052881294), vec3(-1.537398969, 1.875929984, -0.204011206),
    vec3(-0.542943015, 0.045248412, 1.151129905)
);

// Brightness, red against green, blue against yellow: linear in light. The papers' Y, Cx and Cz but for factors and an
// offset, which filters let through, and which rounding would leave in the dark.
vec3 opponent_of_rgb(vec3 rgb) {
    vec3 xyz = XYZ_FROM_RGB * rgb;
    return vec3(xyz.y, xyz.x - xyz.y, xyz.y - xyz.z);
}

vec3 rgb_of_opponent(vec3 c) {
    return RGB_FROM_XYZ * vec3(c.x + c.y, c.x, c.x - c.z);
}

// A driver's own pow is off by 1e-5 of the root on llvmpipe, which L* multiplies by 116: one Newton step mends it.
float cube_root(float x) {
    float root = pow(x, 1.0 / 3.0);
    return root - (root - x / (root * root)) / 3.0;
}

float lab_curve(float x) {
    const float delta = 6.0 / 29.0;
    return x > delta * delta * delta ? cube_root(x) : x / (3.0 * delta * delta) + 4.0 / 29.0;
}

// L*a*b*, with less chroma in the dark, where the eye sees less of it (2020, eq. 6: Hunt).
vec3 hunt_lab(vec3 rgb) {
    vec3 xyz = XYZ_FROM_RGB * rgb;
    vec3 f = vec3(lab_curve(xyz.x), lab_curve(xyz.y), lab_curve(xyz.z));
    float l = 116.0 * f.y - 16.0;
    return vec3(l, 0.01 * l * 500.0 * (f.x - f.y), 0.01 * l * 200.0 * (f.y - f.z));
}

// How far two colours are apart, 0 to 1 (2020, eqs. 7 to 9: HyAB, its largest value that between green and blue).
float colour_difference(vec3 a, vec3 b) {
    const float largest = 41.2760986, knee = 0.4 * largest;
    float d = abs(a.x - b.x) + distance(a.yz, b.yz);
    float e = d > 0.0 ? pow(d, 0.7) : 0.0;
    return e < knee ? e * (0.95 / knee) : 0.95 + (e - knee) / (largest - knee) * 0.05;
}

// Calls a macro with 0 to LINE - 1, or with 0 to BLOCK - 1: constant indices keep arrays in registers.
#define EACH_IN_LINE(DO) \
    DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9) DO(10) DO(11) DO(12) DO(13) \
    DO(14) DO(15) DO(16) DO(17) DO(18) DO(19) DO(20) DO(21) DO(22) DO(23) DO(24) DO(25) DO(26) DO(27)
#define EACH_IN_BLOCK(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
