C     Membrane law of a ring mesh: strains lock on a convex polyhedron,
C     the energy beyond it is half the squared distance in the metric of
C     the stiffness.  Units: N, mm.  Generated, do not edit:
C     @TITLE@
C     In the input, for a thickness of 1 mm (density in t/mm3):
C     *MATERIAL, NAME=ABAQUSNL_RINGS
C     *USER MATERIAL, CONSTANTS=3
C     1., 1., 0.
C     *DENSITY
C     @DENSITY@
C
      SUBROUTINE UMAT(STRESS,STATEV,DDSDDE,SSE,SPD,SCD,RPL,DDSDDT,
     1 DRPLDE,DRPLDT,STRAN,DSTRAN,TIME,DTIME,TEMP,DTEMP,PREDEF,DPRED,
     2 CMNAME,NDI,NSHR,NTENS,NSTATV,PROPS,NPROPS,COORDS,DROT,PNEWDT,
     3 CELENT,DFGRD0,DFGRD1,NOEL,NPT,LAYER,KSPT,KSTEP,KINC)
      IMPLICIT NONE
      CHARACTER*80 CMNAME
      INTEGER NDI,NSHR,NTENS,NSTATV,NPROPS,NOEL,NPT,LAYER,KSPT,KSTEP
      INTEGER KINC
      DOUBLE PRECISION STRESS(NTENS),STATEV(*),DDSDDE(NTENS,NTENS),SSE,
     1 SPD,SCD,RPL,DDSDDT(*),DRPLDE(*),DRPLDT,STRAN(*),DSTRAN(*),
     2 TIME(2),DTIME,TEMP,DTEMP,PREDEF(*),DPRED(*),PROPS(NPROPS),
     3 COORDS(3),DROT(3,3),PNEWDT,CELENT,DFGRD0(3,3),DFGRD1(3,3)
      INTEGER HALVES
      PARAMETER (HALVES=@M@)
      DOUBLE PRECISION E(3),S(3),C(3,3),F(3,3),SM(3,3),T(3,3),J,SCALE
      DOUBLE PRECISION CT(3,3,3,3),CS(3,3,3,3),D(3,3),P(4,HALVES),R(3,3)
      DOUBLE PRECISION V,G,THICK,SLACK,OVER
      INTEGER A,B,I,K,L,M,N,ND,IP,Q,IERR,IA(6),IB(6),IX(6)
      COMMON /RMTAB/ P,R
      DATA IA /1,2,3,1,1,2/, IB /1,2,3,2,3,3/
      IF ((NTENS.NE.3.AND.NTENS.NE.6).OR.NPROPS.LT.1) THEN
        WRITE(*,*) 'UMAT: needs NTENS = 3 or 6, PROPS(1) = thickness'
        PNEWDT = 0.25D0
        RETURN
      END IF
      SCALE = 1.0D0/PROPS(1)
      SLACK = 0.0D0
      IF (NPROPS.GE.2) SCALE = SCALE*PROPS(2)
      IF (NPROPS.GE.3) SLACK = PROPS(3)/PROPS(1)*0.01D0**(KSTEP-1)
      DO 10 I=1,6
   10 IX(I) = I
      IF (NTENS.EQ.3) THEN
C       plane stress: F in the frame of the weave
        ND = 2
        IX(3) = 4
        DO 12 I=1,2
        DO 12 K=1,2
   12   F(I,K) = DFGRD1(I,K)
        J = F(1,1)*F(2,2)-F(1,2)*F(2,1)
      ELSE
C       CalculiX: frame without rotation, F = U = exp(log. strain)
        ND = 3
        CALL RMEXP(STRAN,DSTRAN,F)
        J = EXP(STRAN(1)+STRAN(2)+STRAN(3)
     1   +DSTRAN(1)+DSTRAN(2)+DSTRAN(3))
      END IF
      DO 14 I=1,ND
      DO 14 K=1,ND
      D(I,K) = 0.0D0
      IF (I.EQ.K) D(I,K) = 1.0D0
      T(I,K) = 0.0D0
      SM(I,K) = -0.5D0*D(I,K)
      DO 14 L=1,ND
   14 SM(I,K) = SM(I,K)+0.5D0*F(L,I)*F(L,K)
      E(1) = SM(1,1)
      E(2) = SM(1,2)
      E(3) = SM(2,2)
      CALL RMLAW(E,S,C,SSE,IERR)
      IF (IERR.NE.0) THEN
        WRITE(*,*) 'UMAT: closest point not found, element ',NOEL
        PNEWDT = 0.25D0
        RETURN
      END IF
      SSE = SSE*SCALE+0.5D0*SLACK*(E(1)**2+2.0D0*E(2)**2+E(3)**2)
C     dS_AB/dE_CD, in the plane from the tensor components (11,12,22):
C     the column of C for E12 stands for both E12 and E21.  Across the
C     thickness a stiffness of its own, which nothing in the plane feels
      THICK = SCALE*(R(1,1)**2+R(3,3)**2)
      DO 20 A=1,ND
      DO 20 B=1,ND
      DO 20 M=1,ND
      DO 20 N=1,ND
      G = 0.5D0*(D(A,M)*D(B,N)+D(A,N)*D(B,M))
      IF (MAX(A,B).EQ.3) THEN
        V = THICK*G
      ELSE IF (MAX(M,N).EQ.3) THEN
        V = 0.0D0
      ELSE
        V = C(A+B-1,M+N-1)*SCALE
        IF (M.NE.N) V = 0.5D0*V
        V = V+SLACK*G
      END IF
   20 CT(A,B,M,N) = V
      DO 25 I=1,ND
      DO 25 K=1,ND
      IF (MAX(I,K).EQ.3) THEN
        SM(I,K) = THICK*SM(I,K)
      ELSE
        SM(I,K) = S(I+K-1)*SCALE+SLACK*SM(I,K)
      END IF
   25 CONTINUE
      DO 30 I=1,ND
      DO 30 K=1,ND
      DO 30 A=1,ND
      DO 30 B=1,ND
   30 T(I,K) = T(I,K)+F(I,A)*SM(A,B)*F(K,B)/J
C     CalculiX pulls the tangent back to dS/dE by U alone and adds what
C     the stress contributes itself
      G = 0.5D0
      OVER = 1.0D0/J
      IF (ND.EQ.3) THEN
        G = 0.0D0
        OVER = 1.0D0
      END IF
      DO 60 I=1,ND
      DO 60 K=1,ND
      DO 60 L=1,ND
      DO 60 Q=1,ND
      V = 0.0D0
      DO 50 A=1,ND
      DO 50 B=1,ND
      DO 50 M=1,ND
      DO 50 N=1,ND
   50 V = V+F(I,A)*F(K,B)*F(L,M)*F(Q,N)*CT(A,B,M,N)*OVER
      CS(I,K,L,Q) = V+G*(D(I,L)*T(K,Q)+D(K,L)*T(I,Q)
     1 +D(I,Q)*T(K,L)+D(K,Q)*T(I,L))
   60 CONTINUE
      DO 70 I=1,NTENS
      STRESS(I) = T(IA(IX(I)),IB(IX(I)))
      DO 70 IP=1,NTENS
   70 DDSDDE(I,IP) = CS(IA(IX(I)),IB(IX(I)),IA(IX(IP)),IB(IX(IP)))
      RETURN
      END
C
      SUBROUTINE UMAT_USER(AMAT,IEL,IINT,KODE,PROPS,EMEC,EMEC0,BETA,
     1 XOKL,VOJ,XKL,VJ,ITHERM,T1L,DTIME,TIME,TTIME,ICMD,IELAS,MI,
     2 NSTATE,XSINI,XSTATE,STRE,STIFF,IORIEN,PGAUSS,ORAB,PNEWDT,IPKON)
C     CalculiX's own interface, for whole sheets from a flat start:
C     material USER..., second Piola-Kirchhoff stress of Green's strain.
C     PROPS: thickness, total load over size (N/mm).  Up to time 1 the
C     sheet stiffens and an even tension of slack mesh fades; then the
C     law is stiff and smooth within 1 % of strain.  A constant tension
C     across the thickness, with no stiffness, draws it to 0: the energy
C     is convex in all displacements, also of nodes off the middle plane
      IMPLICIT NONE
      CHARACTER*80 AMAT
      INTEGER IEL,IINT,KODE,ITHERM(*),ICMD,IELAS,MI(*),NSTATE,IORIEN
      INTEGER IPKON(*),I,K,IERR
      DOUBLE PRECISION PROPS(*),EMEC(6),EMEC0(6),BETA(6),XOKL(3,3),VOJ
      DOUBLE PRECISION XKL(3,3),VJ,T1L,DTIME,TIME,TTIME,XSINI(*)
      DOUBLE PRECISION XSTATE(*),STRE(6),STIFF(21),PGAUSS(3),ORAB(7,*)
      DOUBLE PRECISION PNEWDT,E(3),S(3),C(3,3),P(4,@M@),R(3,3)
      DOUBLE PRECISION T,Q,SIZE,SCALE,SLACK
      COMMON /RMTAB/ P,R
      T = MIN(TTIME+TIME,1.0D0)
      Q = PROPS(2)/PROPS(1)
      SIZE = 0.0D0
      DO 10 I=1,3
      DO 10 K=1,3
   10 SIZE = SIZE+0.25D0*R(I,K)**2
      SCALE = 5.0D0*300.0D0**T*Q/SIZE
      SLACK = 1.5D0*0.0033D0**T*Q
      E(1) = EMEC(1)
      E(2) = EMEC(4)
      E(3) = EMEC(2)
      SIZE = SQRT(SIZE)
      CALL RMSOFT(E,0.03D0*SIZE,0.02D0*0.5D0**T*SIZE,S,C,IERR)
      IF (IERR.NE.0) PNEWDT = 0.25D0
      STRE(1) = SCALE*S(1)+SLACK
      STRE(2) = SCALE*S(3)+SLACK
      STRE(3) = Q
      STRE(4) = SCALE*S(2)
      STRE(5) = 0.0D0
      STRE(6) = 0.0D0
      DO 20 I=1,21
   20 STIFF(I) = 0.0D0
      STIFF(1) = SCALE*C(1,1)
      STIFF(2) = SCALE*C(1,3)
      STIFF(3) = SCALE*C(3,3)
      STIFF(7) = 0.5D0*SCALE*C(1,2)
      STIFF(8) = 0.5D0*SCALE*C(3,2)
      STIFF(10) = 0.5D0*SCALE*C(2,2)
      RETURN
      END
C
      SUBROUTINE RMEXP(STRAN,DSTRAN,U)
C     U = exp(STRAN+DSTRAN), symmetric, by a series at a sixteenth and
C     four squarings; engineering shear, order 11,22,33,12,13,23.
      IMPLICIT NONE
      DOUBLE PRECISION STRAN(6),DSTRAN(6),U(3,3),X(3,3),V(3,3)
      INTEGER I,K,L,N,IX(3,3)
      DATA IX /1,4,5,4,2,6,5,6,3/
      DO 10 I=1,3
      DO 10 K=1,3
      U(I,K) = 0.0D0
      IF (I.EQ.K) U(I,K) = 1.0D0
      X(I,K) = (STRAN(IX(I,K))+DSTRAN(IX(I,K)))/16.0D0
   10 IF (I.NE.K) X(I,K) = 0.5D0*X(I,K)
      DO 40 N=12,1,-1
      DO 20 I=1,3
      DO 20 K=1,3
      V(I,K) = 0.0D0
      IF (I.EQ.K) V(I,K) = 1.0D0
      DO 20 L=1,3
   20 V(I,K) = V(I,K)+X(I,L)*U(L,K)/N
      DO 40 I=1,3
      DO 40 K=1,3
   40 U(I,K) = V(I,K)
      DO 70 N=1,4
      DO 60 I=1,3
      DO 60 K=1,3
      V(I,K) = 0.0D0
      DO 60 L=1,3
   60 V(I,K) = V(I,K)+U(I,L)*U(L,K)
      DO 70 I=1,3
      DO 70 K=1,3
   70 U(I,K) = V(I,K)
      RETURN
      END
C
      SUBROUTINE RMLAW(E,S,C,PSI,IERR)
C     Line load S, tangent C (tensor components) and energy PSI at E;
C     IERR = 1 if the closest point is not found.
      IMPLICIT NONE
      INTEGER IERR
      DOUBLE PRECISION E(3),S(3),C(3,3),PSI,SH(3),PR(3,3)
      CALL RMNEAR(E,0.0D0,SH,PR,PSI,IERR)
      CALL RMBACK(SH,PR,S,C)
      RETURN
      END
C
      SUBROUTINE RMSOFT(E,RAD,EPS,S,C,IERR)
C     The same of the body that is smaller by RAD all round and grown
C     by a ball of radius RAD, its kink at the surface smooth over EPS
C     on both sides; strains, in the metric of the stiffness.
      IMPLICIT NONE
      INTEGER I,K,IERR
      DOUBLE PRECISION E(3),RAD,EPS,S(3),C(3,3),PSI,SH(3),PR(3,3)
      DOUBLE PRECISION D,T,F,G
      CALL RMNEAR(E,RAD,SH,PR,PSI,IERR)
      D = MAX(SQRT(2.0D0*PSI),1.0D-30)
      T = MAX(D-RAD+EPS,0.0D0)
      G = MIN(0.5D0*T/EPS,1.0D0)
      F = 0.25D0*T*T/EPS
      IF (T.GT.2.0D0*EPS) F = T-EPS
      DO 10 I=1,3
      DO 10 K=1,3
   10 PR(I,K) = F/D*PR(I,K)+(G-F/D)*SH(I)*SH(K)/D**2
      DO 20 I=1,3
   20 SH(I) = F/D*SH(I)
      CALL RMBACK(SH,PR,S,C)
      RETURN
      END
C
      SUBROUTINE RMBACK(SH,PR,S,C)
C     Stress and tangent in tensor components from metric coordinates.
      IMPLICIT NONE
      INTEGER M,I,K,L,N
      PARAMETER (M=@M@)
      DOUBLE PRECISION SH(3),PR(3,3),S(3),C(3,3),P(4,M),R(3,3),W(3)
      COMMON /RMTAB/ P,R
      DATA W /1.0D0,2.0D0,1.0D0/
      DO 110 I=1,3
      S(I) = (R(1,I)*SH(1)+R(2,I)*SH(2)+R(3,I)*SH(3))/W(I)
      DO 110 L=1,3
      C(I,L) = 0.0D0
      DO 100 K=1,3
      DO 100 N=1,3
  100 C(I,L) = C(I,L)+R(K,I)*PR(K,N)*R(N,L)/W(I)
  110 CONTINUE
      RETURN
      END
C
      SUBROUTINE RMNEAR(E,RAD,SH,PR,PSI,IERR)
C     The way SH to E from the closest point of the half-spaces moved
C     inwards by RAD, the projector PR on the active normals, half the
C     squared distance PSI.
      IMPLICIT NONE
      INTEGER M,IERR
      PARAMETER (M=@M@)
      DOUBLE PRECISION E(3),RAD,PSI,P(4,M),R(3,3)
      DOUBLE PRECISION Y(3),SH(3),X(3),TOP,V,PR(3,3),U(3,3),LEN,FAC(4)
      INTEGER I,K,L,N,ROUND,WORST,ID(4),COUNT
      COMMON /RMTAB/ P,R
      IERR = 0
      PSI = 0.0D0
      COUNT = 0
      DO 10 I=1,3
      SH(I) = 0.0D0
   10 Y(I) = R(I,1)*E(1)+R(I,2)*E(2)+R(I,3)*E(3)
      DO 50 ROUND=1,@ROUNDS@
      DO 20 I=1,3
   20 X(I) = Y(I)-SH(I)
      TOP = @TOLERANCE@
      WORST = 0
      DO 30 K=1,M
      V = P(1,K)*X(1)+P(2,K)*X(2)+P(3,K)*X(3)+P(4,K)+RAD
      IF (V.GT.TOP) THEN
        TOP = V
        WORST = K
      END IF
   30 CONTINUE
      IF (WORST.EQ.0) GO TO 60
      V = PSI
      CALL RMBEST(Y,RAD,WORST,ID,FAC,COUNT,SH,PSI)
      IF (PSI.LE.V) GO TO 60
   50 CONTINUE
      IERR = 1
   60 CONTINUE
C     projector on the span of the active normals, by Gram-Schmidt
      DO 65 I=1,3
      DO 65 L=1,3
   65 PR(I,L) = 0.0D0
      DO 90 K=1,COUNT
      DO 70 I=1,3
   70 U(I,K) = P(I,ID(K))
      DO 80 N=1,2
      DO 80 L=1,K-1
      V = U(1,L)*U(1,K)+U(2,L)*U(2,K)+U(3,L)*U(3,K)
      DO 80 I=1,3
   80 U(I,K) = U(I,K)-V*U(I,L)
      LEN = SQRT(U(1,K)**2+U(2,K)**2+U(3,K)**2)
      DO 85 I=1,3
   85 U(I,K) = U(I,K)/LEN
      DO 90 I=1,3
      DO 90 L=1,3
   90 PR(I,L) = PR(I,L)+U(I,K)*U(L,K)
      RETURN
      END
C
      SUBROUTINE RMBEST(Y,RAD,NEW,ID,FAC,COUNT,SH,PSI)
C     The best of NEW alone, with one and with two of the COUNT active
C     half-spaces ID: largest energy with multipliers not negative.
      IMPLICIT NONE
      INTEGER M
      PARAMETER (M=@M@)
      DOUBLE PRECISION RAD,Y(3),FAC(4),SH(3),PSI,P(4,M),R(3,3)
      DOUBLE PRECISION N(3,3),D(3,3),V(3),LAM(3),T(3),EN,BEST(3),TOP
      INTEGER NEW,ID(4),COUNT,KEEP(3),NK,A,B,I,K,SIZE,LIST(3)
      LOGICAL OK
      COMMON /RMTAB/ P,R
      TOP = PSI
      NK = 0
      DO 90 A=0,COUNT
      DO 90 B=A,COUNT
      IF (A.EQ.0.AND.B.GT.0) GO TO 90
      IF (A.GT.0.AND.B.EQ.A) THEN
        SIZE = 2
      ELSE IF (A.EQ.0) THEN
        SIZE = 1
      ELSE
        SIZE = 3
      END IF
      LIST(1) = NEW
      IF (SIZE.GE.2) LIST(2) = ID(A)
      IF (SIZE.EQ.3) LIST(3) = ID(B)
      DO 20 K=1,SIZE
      V(K) = P(4,LIST(K))+RAD
      DO 20 I=1,3
      N(I,K) = P(I,LIST(K))
   20 V(K) = V(K)+N(I,K)*Y(I)
      CALL RMDUAL(N,SIZE,D,OK)
      IF (.NOT.OK) GO TO 90
      DO 30 I=1,3
      T(I) = 0.0D0
      DO 30 K=1,SIZE
   30 T(I) = T(I)+V(K)*D(I,K)
      DO 40 K=1,SIZE
      LAM(K) = D(1,K)*T(1)+D(2,K)*T(2)+D(3,K)*T(3)
      IF (LAM(K).LT.0.0D0) GO TO 90
   40 CONTINUE
      EN = 0.5D0*(T(1)**2+T(2)**2+T(3)**2)
      IF (EN.GT.TOP) THEN
        TOP = EN
        NK = 0
        DO 50 K=1,SIZE
        IF (LAM(K).GT.0.0D0) THEN
          NK = NK+1
          KEEP(NK) = LIST(K)
        END IF
   50   CONTINUE
        DO 60 I=1,3
   60   BEST(I) = T(I)
      END IF
   90 CONTINUE
      IF (NK.EQ.0) RETURN
      PSI = TOP
      COUNT = NK
      DO 100 K=1,NK
  100 ID(K) = KEEP(K)
      DO 110 I=1,3
  110 SH(I) = BEST(I)
      RETURN
      END
C
      SUBROUTINE RMDUAL(N,SIZE,D,OK)
C     Vectors D dual to SIZE normals N in their span.
      IMPLICIT NONE
      INTEGER SIZE,I
      DOUBLE PRECISION N(3,3),D(3,3),C(3),Q,L1,L2,L3,SMALL
      PARAMETER (SMALL=@SMALL@)
      LOGICAL OK
      L1 = N(1,1)**2+N(2,1)**2+N(3,1)**2
      OK = .TRUE.
      IF (SIZE.EQ.1) THEN
        DO 10 I=1,3
   10   D(I,1) = N(I,1)/L1
        RETURN
      END IF
      L2 = N(1,2)**2+N(2,2)**2+N(3,2)**2
      CALL RMCROS(N(1,1),N(1,2),C)
      IF (SIZE.EQ.2) THEN
        Q = C(1)**2+C(2)**2+C(3)**2
        OK = Q.GT.SMALL*L1*L2
        IF (.NOT.OK) RETURN
        DO 20 I=1,3
   20   C(I) = C(I)/Q
        CALL RMCROS(N(1,2),C,D(1,1))
        CALL RMCROS(C,N(1,1),D(1,2))
        RETURN
      END IF
      L3 = N(1,3)**2+N(2,3)**2+N(3,3)**2
      Q = C(1)*N(1,3)+C(2)*N(2,3)+C(3)*N(3,3)
      OK = Q*Q.GT.SMALL*L1*L2*L3
      IF (.NOT.OK) RETURN
      CALL RMCROS(N(1,2),N(1,3),D(1,1))
      CALL RMCROS(N(1,3),N(1,1),D(1,2))
      DO 30 I=1,3
      D(I,1) = D(I,1)/Q
      D(I,2) = D(I,2)/Q
   30 D(I,3) = C(I)/Q
      RETURN
      END
C
      SUBROUTINE RMCROS(A,B,C)
      IMPLICIT NONE
      DOUBLE PRECISION A(3),B(3),C(3)
      C(1) = A(2)*B(3)-A(3)*B(2)
      C(2) = A(3)*B(1)-A(1)*B(3)
      C(3) = A(1)*B(2)-A(2)*B(1)
      RETURN
      END
C
      BLOCK DATA RMINIT
C     P: normals and limits in metric coordinates, one half-space after
C     the other; R: metric coordinates from tensor components.
      IMPLICIT NONE
      INTEGER M,I
      PARAMETER (M=@M@)
      DOUBLE PRECISION P(4*M),R(9)
      COMMON /RMTAB/ P,R
@DATA@
      END
