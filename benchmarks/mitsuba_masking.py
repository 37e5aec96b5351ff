"""Mitsuba's rough conductor with height-correlated masking, as a BSDF for Mitsuba: ``correlatedconductor``.

Mitsuba multiplies the masking of both directions; jaxmc takes heights as correlated (Heitz 2014, equation 99), which
masks less. Everything but that one formula, G2 = 1 / (1 / G1(wi) + 1 / G1(wo) - 1), is Mitsuba's: density, G1, drawing
of visible normals, Fresnel's equations.
"""


def register(mi, dr):
    """Make ``correlatedconductor`` known to Mitsuba, an isotropic ``roughconductor`` with ``distribution`` "ggx"."""

    class CorrelatedConductor(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, float(props["alpha"]), True)
            self.reflectance = mi.Color3f(props["specular_reflectance"])
            self.metal = [mi.ScalarColor3f(props[name]) for name in ("eta", "k")] if "eta" in props else None
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def tint(self, cosine):
            if self.metal is None:
                return self.reflectance
            fresnel = [mi.fresnel_conductor(cosine, mi.Complex2f(eta, k)) for eta, k in zip(*self.metal)]
            return self.reflectance * mi.Color3f(*fresnel)

        def masking(self, wi, wo, half):
            first, second = self.facets.smith_g1(wi, half), self.facets.smith_g1(wo, half)
            seen = (first > 0.0) & (second > 0.0)
            return first, dr.select(seen, dr.rcp(dr.rcp(first) + dr.rcp(second) - 1.0), 0.0)

        def sample(self, ctx, si, sample1, sample2, active=True):
            above = active & (mi.Frame3f.cos_theta(si.wi) > 0.0)
            half, pdf = self.facets.sample(si.wi, sample2)
            bs = mi.BSDFSample3f()
            bs.wo = mi.reflect(si.wi, half)
            bs.eta = 1.0
            bs.sampled_component = mi.UInt32(0)
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            above &= (pdf != 0.0) & (mi.Frame3f.cos_theta(bs.wo) > 0.0)
            bs.pdf = dr.select(above, pdf / (4.0 * dr.dot(bs.wo, half)), 0.0)
            first, both = self.masking(si.wi, bs.wo, half)
            weight = dr.select(above & (first > 0.0), both / first, 0.0)
            return bs, (self.tint(dr.dot(si.wi, half)) * weight) & above

        def eval(self, ctx, si, wo, active=True):
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            above = active & (cos_i > 0.0) & (cos_o > 0.0)
            half = dr.normalize(wo + si.wi)
            _, both = self.masking(si.wi, wo, half)
            value = self.facets.eval(half) * both / (4.0 * cos_i)
            return (self.tint(dr.dot(si.wi, half)) * value) & above

        def pdf(self, ctx, si, wo, active=True):
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            half = dr.normalize(wo + si.wi)
            above = active & (cos_i > 0.0) & (cos_o > 0.0)
            value = self.facets.eval(half) * self.facets.smith_g1(si.wi, half) / (4.0 * cos_i)
            return dr.select(above, value, 0.0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def traverse(self, callback):
            pass

        def to_string(self):
            return "CorrelatedConductor[]"

    mi.register_bsdf("correlatedconductor", CorrelatedConductor)
