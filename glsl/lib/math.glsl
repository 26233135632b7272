// lib/math.glsl -- small helpers that every lib file may use.
const float PI = 3.14159265358979;

float max3(vec3 v) { return max(v.x, max(v.y, v.z)); }
float min3(vec3 v) { return min(v.x, min(v.y, v.z)); }
float square(float x) { return x * x; }
// As an 8-bit image keeps it, to the same step everywhere: drivers may store either neighbour (OpenGL 4.6, 2.3.5), and an
// H100 rounds up not from half a step on, but from 0.50 to 0.56, by the value.
vec3 in_8_bits(vec3 x) { return floor(x * 255.0 + 0.5) / 255.0; }
bool between_in_8_bits(float x) { return abs(floor(x * 255.0 + 0.5) - 127.5) < 127.0; }   // neither 0 nor 1
vec2 square2(vec2 x) { return x * x; }
float pow5(float x) { float x2 = x * x; return x2 * x2 * x; }
vec3 fresnel_schlick(vec3 f0, float f90, float cos_theta) { return f0 + (vec3(f90) - f0) * pow5(clamp(1.0 - cos_theta, 0.0, 1.0)); }
// Neither infinite nor no number at all: what every mean over frames asks of what comes in, or it would keep that for ever.
// Of bits, since compilers may turn comparisons around as if there were only numbers.
bool is_finite(float x) { return (floatBitsToUint(x) & 0x7F800000u) != 0x7F800000u; }
bool is_finite(vec3 v) { return is_finite(v.x) && is_finite(v.y) && is_finite(v.z); }
float luminance(vec3 rgb) { return dot(rgb, vec3(0.2126, 0.7152, 0.0722)); }   // Rec. 709

// atan(y, x) to 2e-7 rad everywhere: drivers' own may be off by 2e-4 (Mesa's acos and atan), which is 3 % of a texel in
// a sky of 1024 columns. Cephes' atanf: odd polynomial on [0, tan(pi / 8)].
float angle_of(float y, float x) {
    float hi = max(abs(x), abs(y)), lo = min(abs(x), abs(y));
    float a = hi > 0.0 ? lo / hi : 0.0;
    bool far = a > 0.41421356;
    if (far) a = (a - 1.0) / (a + 1.0);
    float z = a * a;
    float angle = (((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1) * z * a + a;
    if (far) angle += PI / 4.0;
    if (abs(y) > abs(x)) angle = PI / 2.0 - angle;
    if (x < 0.0) angle = PI - angle;
    return y < 0.0 ? -angle : angle;
}

// Where an equirect image shows a unit direction: the centre column looks along -Z, +X is to its right, row 0 is +Y.
vec2 equirect(vec3 d) { return vec2(0.5 + angle_of(d.x, -d.z) / (2.0 * PI), angle_of(length(d.xz), d.y) / PI); }

// Orthonormal basis about a unit vector. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1) 2017.
mat3 basis(vec3 n) {
    float s = n.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (s + n.z);
    float b = n.x * n.y * a;
    return mat3(vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x), vec3(b, s + n.y * n.y * a, -n.y), n);
}

// Octahedral map of a unit direction to [0, 1]^2 and back. Cigolle et al., JCGT 3(2) 2014.
vec2 oct_encode(vec3 d) {
    d /= abs(d.x) + abs(d.y) + abs(d.z);
    vec2 p = d.z >= 0.0 ? d.xy : (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
    return p * 0.5 + 0.5;
}

vec3 oct_decode(vec2 uv) {
    vec2 p = uv * 2.0 - 1.0;
    vec3 d = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    if (d.z < 0.0) d.xy = (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
    return normalize(d);
}

// Of a GGX lobe: tangent of its deviation. Half of the half vectors are in it, and what is reflected turns twice as far.
float lobe_tangent(float roughness) { return 1.4 * square(roughness); }
